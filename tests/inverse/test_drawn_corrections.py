"""Corrections of tables drawn at random (`drawn_corrections`), and the oracle's parts that draws are made of."""

import numpy as np
import pytest

from matcam import rigs
from matcam.inverse.operator.chosen_cells import chosen_cells, noise_shares
from matcam.inverse.operator.sample_view import SampleView
from matcam.inverse.picture_gain import strengths_gain
from tests.inverse.drawn_corrections import judged, variations
from tests.inverse.drawn_figures import figures, shown, worst
from tests.oracle import drawn_tables as draws
from tests.oracle import sphere_cells as oracle


def test_tails_are_a_lobe():
    """Their facets cover the surface; GGX is one of them; Lambda is Smith's for it."""
    s = np.geomspace(1e-7, 1e6, 200_001)
    for lobe in (oracle.Tails(0.02, 1.6), oracle.Tails(0.1, 3.5)):
        assert np.trapezoid(lobe.p22(s**2) * 2 * np.pi * s**2, np.log(s)) == pytest.approx(1, abs=1e-3)
    cos = np.cos(np.radians([5, 40, 70, 89]))
    np.testing.assert_allclose(oracle.Tails(0.3, 2.0).smith(cos), oracle.GGX(0.3).smith(cos), rtol=1e-8)


@pytest.mark.parametrize("sigma", [0.35, 0.5, 0.7])
def test_a_lens_of_points_has_its_width(sigma):
    for setup in (oracle.disc(sigma), oracle.airy(sigma), oracle.coma(sigma, 1.0)):
        share, x, y = np.array(setup.lens).T
        assert share.sum() == pytest.approx(1)
        np.testing.assert_allclose([share @ x, share @ y], 0, atol=1e-12)
        assert setup.sigma**2 + share @ (x**2 + y**2) / 2 == pytest.approx(sigma**2)


def test_a_lambertian_body_is_seen_as_it_is():
    theta_h, phi_d = (np.radians([[a, b, c]]) for a, b, c in ((0.01, 3, 30), (90, 20, 100)))
    cells = oracle.Cells(theta_h, np.radians([40.5]), phi_d, oracle.disc())
    np.testing.assert_allclose(cells.body() * np.pi, 1, rtol=1e-4)


def test_nodes_that_are_saved_change_nothing():
    cells = np.radians([[0.01, 0.3, 1.5]]), np.radians([40.5]), np.radians([[90.5, 20, 100]])
    for lobe in (oracle.GGX(0.004), oracle.EPD(0.01, 0.55), oracle.Tails(0.002, 1.7)):
        few = oracle.Cells(*cells, finest=draws.finest(lobe))
        np.testing.assert_allclose(few.directions(lobe), oracle.Cells(*cells).directions(lobe), rtol=1e-7)


def test_every_class_is_drawn():
    some = [draws.drawn(number) for number in range(200)]
    for name, wanted in (
        ("family", draws.FAMILIES),
        ("lens", set(draws.LENSES)),
        ("rule", draws.RULES),
        ("known", (0.03, 0.3)),
    ):
        found = [getattr(one, name) for one in some]
        assert all(found.count(value) >= 20 for value in wanted), name
    alpha = [one.lobe.parts[0][1][0] if one.family == "mixture" else one.lobe[0] for one in some]
    assert min(alpha) < 0.001
    assert max(alpha) > 0.25
    assert {len(variations(one.lobe)) for one in some} >= {1, 2, 3}
    assert draws.drawn(7) == draws.drawn(7)


def test_judged_entries_are_of_their_kind():
    draw = draws.drawn(3)
    slices = np.array([3, 45])
    kind, i, k = draws.judged(draw, slices)
    share = draws.facets(draw.lobe, i)
    assert np.all(share[kind == 0] >= 0.5)
    assert np.all((share[kind == 1] < 0.5) & (share[kind == 1] >= 0.01))
    assert np.all(share[kind == 2] < 0.01)
    assert np.isfinite(draws.truth(draw, slices, i, k)).all()


def test_figures_count_what_is_false_and_harmed():
    """Eight supported peaks: right, off by 2.5 and by 4 standard deviations; one not supported that got worse."""
    rows = [[0, 3, 1.0, 0.5, 0.5, value, 0.01, 0.01, 1] for value in (1, 1.005, 0.995, 1.005, 1, 1, 1.025, 1.04)]
    rows.append([0, 3, 1.0, 0.5, 0.9, 1.5, 0.01, 0.01, 0])
    line = {"number": 0, "known": 0.03, "bound": [[0, 0.01], [50, 0.01]], "entries": rows, "f75": [0.01, 0.005]}
    found = figures([line, {"number": 1, "known": 0.3, "error": "no highlight"}])
    assert found["coverage"]["peak, supported"]["within 1"] == pytest.approx(6 / 8)
    assert found["coverage"]["peak, supported"]["within 2"] == pytest.approx(6 / 8)
    assert found["false support"] == pytest.approx(1 / 8)
    assert found["harmed"] == 1
    assert found["failed"] == 1
    assert found["peaks supported where 20 % is kept"]["3%"] == pytest.approx(8 / 9)
    assert found["rms before"] == pytest.approx(0.5)
    assert found["F(75) pulls"] == pytest.approx(2)
    assert "peak, supported: 75.0% within 1" in shown(found)


def test_two_pixels_halve_the_noise_of_a_cell():
    view = SampleView(256.0)
    cells, shares = chosen_cells(view, "centre", 6), noise_shares(rigs.merl(), "centre")
    found = shares[cells.i_theta_h, cells.slices[:, None], cells.i_phi_d][cells.valid]
    assert np.all(found[cells.one_pixel[cells.valid]] == 1)
    assert np.mean(found == 0.5) > 0.9
    assert shares[0, 0, 0] == 1


def test_the_gain_of_pictures_is_read_off_strengths():
    """What scatters by 1 % more than its noise of 0.1 %; and what does not."""
    random = np.random.default_rng(4)
    theta_d = np.radians(np.arange(3.5, 90, 6))
    smooth = 0.5 + 0.3 * np.cos(theta_d)
    noise = np.eye(theta_d.size) * (1e-3 * smooth) ** 2
    for gain in (0.0, 0.01):
        error = np.hypot(1e-3, gain) * random.standard_normal(theta_d.size)
        found = strengths_gain(theta_d, (smooth * (1 + error))[None], noise[None], 0 * noise[None])
        assert 0.5 * gain <= found <= 2 * gain


FIRST, COUNT = 15, 7
"""Of the draws that are made here; `python -m tests.inverse.drawn_corrections 200` makes all."""


@pytest.mark.slow
def test_random_tables():
    """No draw is lost, of a thousand entries not one is harmed, and what is supported is right (docs/correct.md)."""
    lines = [judged(number) for number in range(FIRST, FIRST + COUNT)]
    found = figures(lines)
    print("\n".join([*worst(lines), shown(found)]))
    assert found["failed"] == 0
    assert found["harmed"] / found["entries"] < 1e-3
    assert found["false support"] < 0.01
    assert found["rms after"] < found["rms before"] / 5
    for name, part in found["coverage"].items():
        if part["entries"] > 100 and "not" not in name:
            assert part["within 1"] > 0.6, name
            assert part["within 2"] > 0.93, name


@pytest.mark.slow
def test_one_channel_on_real_pixels_finds_its_lobe():
    """The narrow lobe of draw 28 in one channel of unknown noise: a wrong family made its peaks 18 times too high."""
    line = judged(28)
    found = figures([line])
    print("\n".join(worst([line])))
    assert found["harmed"] == 0
    assert found["false support"] == 0 or np.isnan(found["false support"])
    for kind in ("peak", "slope", "tail"):
        assert found["coverage"][f"{kind}, not supported"]["within 2"] > 0.9
