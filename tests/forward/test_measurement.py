"""Whole tables against what nobody in the package wrote: golden cells, and an adaptive quadrature (tests/oracle)."""

import numpy as np
import pytest

from docs_claims import limit
from matcam import GGX, Microfacet, measure, rigs
from matcam.core.grid import below_horizon, cosines, merl_grid
from matcam.forward.integral.blur import imaging_of
from matcam.forward.sampler.plan import RecordPositions, record_plan
from matcam.forward.sampler.record import record
from tests.golden import rows
from tests.oracle.sphere_record import Setup, Surface, position, recorded_cell

GRID = merl_grid("centre")
RADIUS = 256.0
WIDTH = 5.0  # how far the kernel reaches, px, to the digits that matter


def material(alpha):
    return Microfacet(GGX(alpha), 1.0)


def recorded_cells(alphas, cells):
    """What a table would hold in `cells` (i, j, k) for GGX of each roughness, F = 1, by the operator that `measure`
    applies to all its cells (see test_a_table_is_its_cells): shape (alphas, cells)."""
    i, j, k = np.transpose(cells)
    angles = angles_of(i, j, k)
    cosine, x, y = [], [], []
    for turn in (0, np.pi):
        cosine.append(np.asarray(cosines(*angles[:2], angles[2] + turn)[0]))
        for out, one in zip((x, y), position(*angles[:2], angles[2] + turn, RADIUS), strict=True):
            out.append(one)
    x, y, slices = np.concatenate(x), np.concatenate(y), np.tile(j, 2)
    rig, lamps = rigs.merl(), 2 * GRID.theta_d
    imaging = imaging_of(rig)
    plan = record_plan(imaging, RecordPositions(x, y, lamps[slices]), min(alphas))
    return np.array(
        [
            np.mean(
                np.reshape(record(material(alpha), imaging, plan)[:, 0], (2, -1)) / np.array(cosine),
                0,
            )
            for alpha in alphas
        ]
    )


def misses(cells, truths):
    """Errors of cells (alpha, i, j, k) in units of what is allowed: 1e-4 of the value or 1e-7 of the table's peak, for
    which the highest of 88 cells at the highlight stands in, which is no higher."""
    alphas = sorted({alpha for alpha, *_ in cells})
    found = recorded_cells(alphas, [*(cell for _, *cell in cells), *((0, j, 90) for j in range(88))])
    which = np.array([alphas.index(alpha) for alpha, *_ in cells])
    allowed = np.maximum(limit("recorded-cells") * np.array(truths), 1e-7 * found[:, len(cells) :].max(axis=1)[which])
    return np.abs(found[which, np.arange(len(cells))] - truths) / allowed


def angles_of(i, j, k):
    return GRID.theta_h[i], GRID.theta_d[j], GRID.phi_d[k]


@pytest.mark.slow
def test_the_oracle_against_golden_values():
    """Twenty-four cells, both ways: two quadratures that share nothing but the model."""
    for row in rows("measure_cells"):
        angles = row["theta_h"], row["theta_d"], row["phi_d"]
        directions = recorded_cell(*angles, Surface(row["alpha"]), Setup())
        expected = np.array([row["recorded_one_way"], row["recorded_other_way"]])
        # as the file's note says: 2e-6 where the kernel crosses the limb
        limb = [RADIUS - np.hypot(*position(*angles[:2], angles[2] + turn, RADIUS)) < WIDTH for turn in (0, np.pi)]
        np.testing.assert_array_less(np.abs(directions / expected - 1), np.where(limb, 2e-6, 1e-10))


def test_golden_cells():
    golden = rows("measure_cells")
    cells = [(row["alpha"], row["i_theta_h"], row["i_theta_d"], row["i_phi_d"]) for row in golden]
    missed = misses(cells, [row["recorded"] for row in golden])
    assert missed.max() < 1, list(zip(missed, cells, strict=True))


@pytest.mark.slow
def test_a_table_is_its_cells():
    """`measure` against the golden cells of one roughness, and everywhere against its own operator at single cells: the
    same places, cosines, folding and horizon."""
    table = measure(material(0.005), rigs.merl()).values
    np.testing.assert_array_equal(np.isnan(table[..., 0]), below_horizon("centre"))
    golden = [row for row in rows("measure_cells") if row["alpha"] == 0.005]
    for row in golden:
        value = table[row["i_theta_h"], row["i_theta_d"], row["i_phi_d"]]
        np.testing.assert_allclose(value, row["recorded"], rtol=1e-4)
    cells = positions()[0]
    cells = cells[np.random.default_rng(1).choice(len(cells), 300, replace=False)]
    # cells around a highlight are interpolated along a ring
    atol = 1e-8 * np.nanmax(table)
    np.testing.assert_allclose(table[tuple(cells.T)][:, 0], recorded_cells([0.005], cells)[0], rtol=1e-6, atol=atol)


def positions():
    """Of all cells above the horizon: their numbers, the distance of the darker way from where the light ends, and of its
    row from the middle one, px."""
    i, j, k = (a.ravel() for a in np.meshgrid(np.arange(90), np.arange(90), np.arange(180), indexing="ij"))
    angles = angles_of(i, j, k)
    cos_i, cos_o = (np.asarray(c) for c in cosines(*angles))
    _, y = position(*angles, RADIUS)
    above = (cos_i > 0) & (cos_o > 0)
    edge = RADIUS * (1 - np.sqrt(1 - np.minimum(cos_i, cos_o) ** 2))
    return np.stack([i, j, k], -1)[above], edge[above], np.abs(y)[above]


def drawn_cells(alphas, per_kind, seed):
    """(alpha, i, j, k): at each roughness `per_kind` cells of each kind: any, in the lobe, at the limb or the
    terminator, on the crescent that is left of the lit disc at theta_d > 80 degrees, close to the sphere's poles, and both."""
    random = np.random.default_rng(seed)
    cells, edge, height = positions()
    crescent = cells[:, 1] >= 80
    out = []
    for alpha in alphas:
        kinds = {
            "any": edge > 0,
            "lobe": GRID.theta_h[cells[:, 0]] < 3 * alpha + 0.02,
            "end": edge < 2,
            "crescent": crescent,
            "crescent's end": crescent & (edge < 0.5),
            "pole": height > 0.95 * RADIUS,
            "pole's end": (height > 0.98 * RADIUS) & (edge < 1),
        }
        for chosen in kinds.values():
            picked = random.choice(np.flatnonzero(chosen), per_kind, replace=False)
            out += [(alpha, *map(int, cells[p])) for p in picked]
    return out


def roughnesses(count, seed):
    """Log-uniform in [0.001, 0.3], 0.001 among them."""
    return [0.001, *map(float, np.exp(np.random.default_rng(seed).uniform(*np.log([0.001, 0.3]), count - 1)))]


def check_drawn(cells):
    truths = [np.mean(recorded_cell(*angles_of(*cell), Surface(alpha), Setup(), rtol=1e-7)) for alpha, *cell in cells]
    missed = misses(cells, truths)
    worst = np.argsort(missed)[::-1][:5]
    report = "; ".join(f"{missed[w]:.3g} of what is allowed at {cells[w]}, truth {truths[w]:.6g}" for w in worst)
    print(report)
    assert missed.max() < 1, report


@pytest.mark.slow
def test_random_cells():
    """56 cells of eight roughnesses."""
    check_drawn(drawn_cells(roughnesses(8, seed=5), 1, seed=6))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_many_random_cells(seed):
    """350 cells of ten roughnesses."""
    check_drawn(drawn_cells(roughnesses(10, seed), 5, seed))


def test_no_value_is_negative(monkeypatch):
    """A table of MERL's format has no place for the errors of an interpolation far below the peak."""
    values = np.full((90, 90, 180, 1), -1e-9)
    values[0, 0, 0] = np.nan
    monkeypatch.setattr(
        "matcam.forward.measurement.table_values", lambda *args, **more: (values, np.ones((90, 90, 180)))
    )
    table = measure(Microfacet(GGX(0.1), 1.0), rigs.merl())
    assert float(table.min()) == 0
    assert np.isnan(table.values[0, 0, 0]).all()
