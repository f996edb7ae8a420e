"""Radiance of a sphere on a regular grid whose Fourier transform is accurate within the band of a lens.

A sum over the points of a regular grid is exact except for frequencies that alias into the band of the lens. These
frequencies are above the sampling frequency minus the cutoff of the lens. The radiance has such frequencies only in
three regions. Each region has a separate quadrature:

- the limb, where the radiance ends (`limb_lines.py`);
- the highlight, whose lobe may be narrower than a step (`highlight_patch.py`);
- the terminator, where the slope of the radiance is discontinuous (`terminator.py`).

`regions.py` divides the radiance among the quadratures. The radiance is evaluated once at each node, and the lens is
represented by its transfer function.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.jax import AnyArray, jax, jnp, without_derivatives
from matcam.core.programs import kept_program
from matcam.forward.frequencies.highlight_patch import PatchSize, lay_highlight, patch_size
from matcam.forward.frequencies.limb_lines import LimbLines, lay_limb, limb_lines
from matcam.forward.frequencies.regions import Regions, RegionWidths
from matcam.forward.frequencies.taps import Taps
from matcam.forward.frequencies.terminator import remove_kink
from matcam.forward.integral.scene import Scene, highlight_x
from matcam.sample.curved import Sphere
from matcam.sample.shape import Curved

FINE_ENOUGH = 2.4
"""Smallest number of grid points per pixel, divided by the cutoff of the lens in cycles/px."""
_TILE = 32, 64
"""Rows and columns of a tile of the grid."""
_ACROSS = 30.0
"""Additional number of grid steps in the radius of a sphere, besides the steps that the cutoff of the lens requires."""
_SMALLEST = 2.5
"""Smallest radius of a sphere, px."""
_HIGHEST = 3.3
"""Highest supported cutoff of a lens, cycles/px, which requires 8 grid points per pixel."""


class Laying(NamedTuple):
    """Sizes of the quadratures of limb and highlight.

    A separate program is compiled for each size of the lines, and for each size of the patch.

    Attributes:
        lines: rows for the left and right limb, and columns for the top and bottom.
        patch: size of the patch about the highlight.
    """

    lines: tuple[LimbLines, ...]
    patch: PatchSize


class LightGrid(NamedTuple):
    """Regular grid for the radiance of a sphere.

    Attributes:
        x: positions of the columns, at a constant step, px.
        y: positions of the rows, at a constant step, px. If the radiance is symmetric, the first row is half a step
            above the x axis.
        widths: widths of the regions.
        taps: weights that distribute a node over neighbouring points of the grid.
        symmetric: True if the radiance is symmetric about the x axis, and only the upper half is computed.
    """

    x: np.ndarray
    y: np.ndarray
    widths: RegionWidths
    taps: Taps
    symmetric: bool

    @classmethod
    def of(cls, x: np.ndarray, y: np.ndarray, highest: float, *, symmetric: bool = False) -> LightGrid:
        """Build the grid for a lens. `highest` is the cutoff of the lens, cycles/px."""
        per_px = 1 / abs(x[1] - x[0])
        return cls(x, y, RegionWidths.above(per_px - highest), Taps.below(highest / per_px), symmetric)

    def laying(self, scene: Scene) -> Laying:
        """Choose the sizes of the quadratures of a scene.

        The parameters of the scene must be concrete. Derivatives with respect to them are allowed.
        """
        known = without_derivatives(scene)
        radius = float(known.sample.radius)
        cosine = np.sqrt(1 - (float(highlight_x(known.sample, known.lamp_angle, known.lamp_nearness)) / radius) ** 2)
        step = abs(self.x[1] - self.x[0])
        lines = tuple(
            limb_lines(fixed, radius, self.widths.widest_line, self.taps, upright, sides)
            for fixed, upright, sides in ((self.y, False, (1, -1)), (self.x, True, (1,) if self.symmetric else (1, -1)))
        )
        turned = scene.turn is not None
        return Laying(lines, patch_size(self.widths, cosine, step, self.taps, self.symmetric, turned))

    def laid(self, scene: Scene, laying: Laying | None = None) -> jax.Array:
        """Compute the radiance of a scene on the grid, 1/sr, (rows, columns, channels).

        `laying` contains the sizes of the quadratures. Default: None, the sizes are chosen, which requires concrete
        parameters.
        """
        lines, patch = laying or self.laying(scene)
        grid = _laid(scene, self.x, self.y, self.widths, self.taps, lines)
        return _with_highlight(grid, scene, self.x, self.y, self.widths, self.taps, self.symmetric, patch)


def per_px_for(highest: float, radius: float) -> int:
    """Compute the number of grid points per pixel.

    Args:
        highest: frequency up to which the radiance is used, cycles/px.
        radius: radius of the sphere, px.
    """
    return max(2, int(np.ceil(FINE_ENOUGH * highest)), int(np.ceil(highest + _ACROSS / radius)))


def margin_of(per_px: int, highest: float) -> float:
    """Compute the margin of a grid beyond the sphere, px."""
    return (Taps.below(highest / per_px).reach + 2) / per_px


def serves(sample: Curved, elongation: float, highest: float) -> bool:
    """Check whether the radiance of a sample can be computed on a grid.

    This requires a sphere of at least 2.5 px radius in front of a distant camera, an isotropic lobe, and a cutoff of at
    most 3.3 cycles/px.

    Args:
        sample: the sample.
        elongation: elongation of the material's lobe, no unit.
        highest: cutoff of the lens, cycles/px.
    """
    if not isinstance(sample, Sphere) or not sample.distant or elongation != 1 or highest > _HIGHEST:
        return False
    return bool(jax.lax.stop_gradient(sample.radius) >= _SMALLEST)


@kept_program
def _laid(
    scene: Scene, x: AnyArray, y: AnyArray, widths: RegionWidths, taps: Taps, lines: tuple[LimbLines, ...]
) -> jax.Array:
    """Compute the radiance on the grid without that around the highlight."""
    x, y = jnp.asarray(x), jnp.asarray(y)
    regions = Regions.of(scene, widths)
    grid = _smooth_part(regions, x, y)
    for served in lines:
        across, along = (x, y) if served.upright else (y, x)
        grid = lay_limb(grid, regions, served, across, along, taps)
    grid = remove_kink(grid, regions, False, y, x)
    return remove_kink(grid, regions, True, x, y)


@kept_program
def _with_highlight(
    grid: AnyArray,
    scene: Scene,
    x: AnyArray,
    y: AnyArray,
    widths: RegionWidths,
    taps: Taps,
    symmetric: bool,
    patch: PatchSize,
) -> jax.Array:
    """Add the radiance around the highlight to the grid."""
    x, y = jnp.asarray(x), jnp.asarray(y)
    return lay_highlight(jnp.asarray(grid), Regions.of(scene, widths), patch, x, y, taps, symmetric)


def _smooth_part(regions: Regions, x: jax.Array, y: jax.Array) -> jax.Array:
    """Compute the radiance that the points of the grid contribute outside limb and highlight, 1/sr.

    The grid is divided into tiles, because most of an image is dark.
    """
    channels = regions.scene.channels()
    down, across = (-(-line.size // side) for line, side in zip((y, x), _TILE, strict=True))

    def tile(number: jax.Array) -> jax.Array:
        rows, columns = (
            line[0] + (line[1] - line[0]) * (start * side + jnp.arange(side))
            for line, start, side in zip((y, x), (number // across, number % across), _TILE, strict=True)
        )
        at = columns[None, :], rows[:, None]
        return jax.lax.cond(
            jnp.any(regions.lit(*at)) & ~regions.all_limb,
            lambda: regions.sent(*at) * regions.inside(*at)[..., None],
            lambda: jnp.zeros((*_TILE, channels)),
        )

    tiles = jax.lax.map(tile, jnp.arange(down * across)).reshape(down, across, *_TILE, channels)
    return tiles.transpose(0, 2, 1, 3, 4).reshape(down * _TILE[0], across * _TILE[1], channels)[: y.size, : x.size]
