"""The public cases against a second quadrature, `sphere_cells.Cells`, in 200 random cells or pixels of each case."""

import numpy as np
import pytest
from benchmarks.recovery import cases, generate, photographs, records

from tests.oracle import real_pixels, sphere_cells
from tests.oracle.merl_lobe import PHI_D, THETA_D, THETA_H
from tests.oracle.real_pixels import RealTable
from tests.oracle.whole_tables import finest

SLICES = (0, 9, 18, 27, 36, 45, 54, 63, 71, 77)
EACH = 24
"""Random cells in each slice: at least 200 of all remain, without those that interpolate pixels at the limb."""


class AnyLight(sphere_cells.Cells):
    """Rule for chosen cells, of a material that is not a lobe: a coat."""

    def record(self, light):
        return self._seen(light)


def drawn_cells(name):
    """Indices (slices, EACH) of random judged cells: half of them within 25 rings of the highlight."""
    random = np.random.default_rng([17, *name.encode()])
    judged, rows = generate.judged_cells(), []
    for j in SLICES:
        near, all_of_them = np.argwhere(judged[:25, j]), np.argwhere(judged[:, j])
        rows.append(np.concatenate([group[random.integers(0, len(group), EACH // 2)] for group in (near, all_of_them)]))
    return np.moveaxis(np.array(rows), -1, 0)


def of_cells(case, i, k):
    """Clean records (terms, slices, cells) by both quadratures."""
    found = records.records(case, SLICES)["cells"].mean(-1)
    found = found[:, i, np.arange(len(SLICES))[:, None], k]
    theta_d = THETA_D[list(SLICES)]
    rule = AnyLight(THETA_H[i], theta_d, PHI_D[k], case.table.setup, finest=finest(case.table))
    return found, np.array([rule.record(term.light).mean(-1) for term in case.table.terms])


def of_pixels(case, i, k):
    """Clean records (terms, slices, cells) of cells that are looked up in photographs, by both quadratures."""
    kept, found = records.records(case, SLICES), []
    for n, j in enumerate(SLICES):
        share, number, _ = records.pixels(case, j)
        whole = np.einsum("cn,tcn->tc", share, kept[f"pixels-{j}"][:, number]).reshape(-1, 90, 180)
        found.append(whole[:, i[n], k[n]])
    looked_up = [(THETA_H[a], PHI_D[b]) for a, b in zip(i, k, strict=True)]
    rule = RealTable(
        case.rule, case.phase, THETA_D[list(SLICES)], looked_up, case.table.setup, finest(case.table)
    )  # fmt: skip
    right = [rule.values(rule.pixels(term.lobe)) for term in case.table.terms]
    return np.moveaxis(np.array(found), 0, 1), np.array(right)


@pytest.mark.slow
@pytest.mark.parametrize("case", cases.PUBLIC, ids=lambda case: case.name)
def test_random_cells(case):
    """1e-4 of the value, or 1e-7 of the largest value of the slice, for each term of the material."""
    i, k = drawn_cells(case.name)
    found, right = (of_cells if case.rule == "centre" else of_pixels)(case, i, k)
    assert found.shape == right.shape == (len(case.table.terms), len(SLICES), EACH)
    agree(case, found, right)


def agree(case, found, right):
    there = np.isfinite(right).all(0)
    assert there.sum() >= 200
    # an error of 1e-7 of the largest value of the slice is allowed, too
    off = (np.abs(found - right) / np.maximum(right, 1e-3 * np.nanmax(right, axis=-1, keepdims=True)))[:, there]
    print(f"{case.name}: {off.max():.1e} of the value at {there.sum()} positions")
    assert (off <= 1e-4).all(), (case.name, off.max())


def drawn_pixels(case, j):
    """Positions (EACH + 1, 2) of the pixel at the highlight of slice j, and of random ones: half of them near the highlight."""
    random = np.random.default_rng([j, *case.name.encode()])
    position = photographs.positions(case, j)
    dark = -np.cos(2 * THETA_D[j]) * np.sqrt(np.maximum(cases.RADIUS**2 - position[:, 1] ** 2, 0))
    inside = position[np.minimum(cases.RADIUS - np.hypot(*position.T), position[:, 0] - dark) > generate.EDGE]
    distance = np.hypot(inside[:, 0] - cases.RADIUS * np.sin(THETA_D[j]), inside[:, 1])
    drawn = [group[random.integers(0, len(group), EACH // 2)] for group in (inside[distance < 12], inside)]
    return np.concatenate([inside[[np.argmin(distance)]], *drawn])


@pytest.mark.slow
@pytest.mark.parametrize("case", photographs.PUBLIC, ids=lambda case: case.name)
def test_random_pixels(case):
    """1e-4 of the value, or 1e-7 of the largest value of the photograph, for each term of the material."""
    position = np.array([drawn_pixels(case, j) for j in photographs.SLICES])
    found = np.stack(
        [photographs.records_of(case, j, at) for j, at in zip(photographs.SLICES, position, strict=True)], 1
    )
    theta_d = THETA_D[photographs.SLICES]
    theta_h, psi = real_pixels.angles_of(position, theta_d[:, None])
    rule = AnyLight(theta_h, theta_d, np.pi - psi, case.table.setup, turns=(0.0,), finest=finest(case.table))
    right = np.array([rule.record(term.light)[..., 0] for term in case.table.terms])
    agree(case, found, right * real_pixels.light_cosine(position, theta_d[:, None]))
