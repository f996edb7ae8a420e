"""The cells of a table that a material is fitted to: few, far and near, and no two of them read from one pixel.

Near the peak about 75 cells of a MERL table come from one pixel and share its noise; elsewhere a cell is a pixel. A fit
wants data whose errors are independent, so of each pixel one cell is kept: the likelihood of what is kept is then exact,
picture by picture, with nothing counted twice. What is left out is neighbours in one pixel, which say the same again, and
most of the smooth flanks, where hundreds of pixels would only say better what is known to a fraction of a per cent.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.grid import GRID_SHAPE, Sampling, merl_grid

_CELLS = 112
"""Kept in each slice, at most: one shape for all."""

_RINGS = np.concatenate([np.arange(12), np.arange(12, 26, 2), np.arange(26, 90, 5)])
_MOST_IN_RING = 4
NEAR_RINGS = 12
NEAR_COSINE, FAR_COSINE = 0.06, 0.17
"""Smallest cosine of light and view that is used, in the rings about the highlight and beyond them: closer to the ends of the
light a cell hangs on the sphere's last pixels."""


class ChosenCells(NamedTuple):
    """Cells of some theta_d slices and the two pixels behind each. Shapes: s slices, n cells; the last axis is the way."""

    slices: np.ndarray
    """(s,): indices of theta_d."""
    theta_d: np.ndarray
    """(s,) rad."""
    i_theta_h: np.ndarray
    """(s, n)."""
    i_phi_d: np.ndarray
    """(s, n)."""
    kept: np.ndarray
    """(s, n): False where a slice has fewer cells."""
    x: np.ndarray
    """(s, n, 2): of the pixels' centres, px from the optical axis, the lamp towards +x."""
    y: np.ndarray
    cos_i: np.ndarray
    """(s, n, 2): of the light at each place."""
    one_pixel: np.ndarray
    """(s, n): both ways fall into the same pixel."""


def chosen_cells(radius: float, sampling: Sampling, every: int = 1) -> ChosenCells:
    """Choose cells in every `every`-th slice of theta_d of a table recorded from a distant sphere of `radius` px."""
    grid = merl_grid(sampling)
    slices = np.arange(every // 2, GRID_SHAPE[1], every)
    columns = []
    for j in slices:
        columns.append(_of_slice(radius, grid.theta_h, grid.theta_d[j], grid.phi_d))
    i, k, kept = (np.stack(part) for part in zip(*columns, strict=True))
    x, y, cos_i, _ = places(radius, grid.theta_h[i], grid.theta_d[slices, None], grid.phi_d[k])
    pixel = np.rint(np.stack([x, y]))
    return ChosenCells(
        slices, grid.theta_d[slices], i, k, kept, x, y, cos_i, (pixel[..., 0] == pixel[..., 1]).all(axis=0)
    )


def places(
    radius: float, theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(x, y) px and the cosines of light and view at the two places that show a cell, on a last axis (MODEL 3)."""
    psi = np.pi - phi_d[..., None] + np.array([0.0, np.pi])
    th, td = theta_h[..., None], theta_d[..., None]
    mean, half = np.cos(th) * np.cos(td), np.sin(th) * np.sin(td) * np.cos(psi)
    x = radius * (np.cos(th) * np.sin(td) + np.sin(th) * np.cos(psi) * np.cos(td))
    return x, radius * np.sin(th) * np.sin(psi), mean + half, mean - half


def _of_slice(
    radius: float, theta_h: np.ndarray, theta_d: float, phi_d: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(i, k, kept) of one slice, rings from the highlight outwards; a cell is refused if one of its pixels is taken."""
    taken: set[tuple[float, float]] = set()
    chosen: list[tuple[int, int]] = []
    for ring in _RINGS:
        # the ring's half circumference in px, foreshortened in one direction
        length = np.pi * radius * theta_h[ring] * np.sqrt((1 + np.cos(theta_d) ** 2) / 2)
        near = ring < NEAR_RINGS
        count = int(np.clip(np.ceil(2 * length), 1, 24)) if near else _MOST_IN_RING
        wanted = 5 if near else _MOST_IN_RING if ring < 26 else 3
        share = (np.arange(count) + (0.5 if ring % 2 else 0.2)) / count
        k = np.unique((share * phi_d.size).astype(int))
        i = np.full(k.size, ring)
        x, y, cos_i, cos_o = places(radius, theta_h[i], np.full(k.size, theta_d), phi_d[k])
        seen = (np.minimum(cos_i, cos_o) > (NEAR_COSINE if near else FAR_COSINE)).all(axis=-1)
        # in an order that spreads over the ring even where not all are taken
        for n in np.argsort((np.arange(k.size) * 0.618) % 1):
            pixels = {(round(float(a)), round(float(b))) for a, b in zip(x[n], y[n], strict=True)}
            if wanted and seen[n] and not pixels & taken and len(chosen) < _CELLS:
                taken |= pixels
                chosen.append((int(i[n]), int(k[n])))
                wanted -= 1
    kept = np.arange(_CELLS) < len(chosen)
    filled = np.array(chosen + [(0, 0)] * (_CELLS - len(chosen)))
    return filled[:, 0], filled[:, 1], kept
