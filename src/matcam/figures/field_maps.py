"""Field figures of a calibration: map of the blur of the lens, and lateral colour over the distance from the centre."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

from matcam.figures.style import BLACK, CHANNELS

if TYPE_CHECKING:
    from matcam.calibration.camera.calibration import Calibration
    from matcam.calibration.camera.evidence import EdgeTable
    from matcam.calibration.camera.lateral_colour import LateralColour

_FEWEST = 2  # smallest number of edges in a part, for robustness against one bad edge


class BlurMap(NamedTuple):
    """Median blur of the lens in rectangular parts of the image.

    Attributes:
        x: borders of the columns of parts, px, (columns + 1,).
        y: borders of the rows of parts, px, (rows + 1,).
        sigma: median standard deviation of the blur as a Gaussian, px, (rows, columns); NaN in parts with fewer than
            two edges.
        edges: number of edges in each part, no unit, (rows, columns).
    """

    x: np.ndarray
    y: np.ndarray
    sigma: np.ndarray
    edges: np.ndarray


def blur_map(edges: EdgeTable, shape: tuple[int, int]) -> BlurMap:
    """Compute the median blur of edges in parts of the image.

    Few edges have few parts. `shape` is (height, width) of the image, px.
    """
    height, width = shape
    # at most 8 parts along the longer side, and three quarters of them along the other; fewer with less than 6 edges in each
    longer = int(np.clip(np.round(np.sqrt(edges.x.size / 6 * 4 / 3)), 1, 8))
    shorter = max(round(longer * 3 / 4), 1)
    rows, columns = (shorter, longer) if width >= height else (longer, shorter)
    x, y = np.linspace(-0.5, width - 0.5, columns + 1), np.linspace(-0.5, height - 0.5, rows + 1)
    column = np.clip(np.searchsorted(x, edges.x) - 1, 0, columns - 1)
    row = np.clip(np.searchsorted(y, edges.y) - 1, 0, rows - 1)
    sigma, count = np.full((rows, columns), np.nan), np.zeros((rows, columns), int)
    for i in range(rows):
        for k in range(columns):
            here = edges.sigma[(row == i) & (column == k)]
            count[i, k] = here.size
            if here.size >= _FEWEST:
                sigma[i, k] = np.median(here)
    return BlurMap(x, y, sigma, count)


def draw_blur_map(axes: Axes, edges: EdgeTable, shape: tuple[int, int], channel: str) -> None:
    found = blur_map(edges, shape)
    axes.set_title(f"Blur in parts of the image, {channel}: median sigma [px]", loc="left", parse_math=False)
    axes.grid(False)
    axes.plot(edges.x, edges.y, ".", ms=2, mew=0, color=BLACK, alpha=0.3, zorder=3)
    axes.set(xlabel="x [px]", ylabel="y [px]", xlim=found.x[[0, -1]], ylim=found.y[[-1, 0]], aspect="equal")
    if np.isnan(found.sigma).all():
        axes.text(0.5, 0.5, f"fewer than {_FEWEST} edges in every part", ha="center", transform=axes.transAxes)
        return
    low, high = np.nanmin(found.sigma), np.nanmax(found.sigma)
    # a range of the colour scale below 2 % of the width would show only noise
    more = max(0.02 * high - (high - low), 0.0) / 2
    drawn = axes.pcolormesh(
        found.x, found.y, np.ma.masked_invalid(found.sigma), cmap="cividis", vmin=low - more, vmax=high + more
    )
    axes.figure.colorbar(drawn, ax=axes, label="sigma [px]", shrink=0.85)
    for (i, k), sigma in np.ndenumerate(found.sigma):
        if np.isfinite(sigma):
            axes.text(
                found.x[k : k + 2].mean(), found.y[i : i + 2].mean(), f"{sigma:.3f}",
                ha="center", va="center", fontsize=7.5, color=BLACK, zorder=4,
                path_effects=[withStroke(linewidth=2.5, foreground="white")],  # covers the dots of the edges
            )  # fmt: skip


def draw_lateral_colour(axes: Axes, found: Calibration, shape: tuple[int, int]) -> None:
    corner = float(np.hypot(*shape) / 2)
    radius = np.linspace(0, corner, 101)
    for name, lateral in found.lateral_colour.items():
        shift = lateral_shift(lateral, radius, corner)
        axes.plot(radius, shift, color=CHANNELS[name], lw=1.3, label=f"{name}: {lateral.edges} edges")
        axes.errorbar(
            corner, lateral.corner, 2 * lateral.corner_std, fmt="o", ms=4, lw=1, capsize=3, color=CHANNELS[name]
        )
    axes.axhline(0, color=BLACK, lw=0.6)
    axes.set(xlabel="distance from the centre of the image [px]", ylabel="radial displacement from G [px]")
    axes.legend(loc="best", fontsize=8.5)
    axes.set_title("Lateral colour, 2 std in the corners", loc="left")


def lateral_shift(lateral: LateralColour, radius: np.ndarray, corner: float) -> np.ndarray:
    """Compute the radial displacement of a colour relative to green, px.

    `radius` contains distances from the centre of the image, px. `corner` is the distance of the corners from the
    centre, px.
    """
    linear = lateral.scale * corner
    rho = radius / corner
    return np.asarray(linear * rho + (lateral.corner - linear) * rho**3)
