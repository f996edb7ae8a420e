"""Light of a sphere on a regular grid whose transform is accurate within the band of a lens.

A sum over regular points is exact except for aliased frequencies: those beyond one over the step less the cutoff of the
lens. Light has such frequencies only in three regions, which have their own quadratures:

- the limb, where light ends (`limb_lines.py`);
- the highlight, whose lobe may be narrower than a step (`highlight_patch.py`);
- the terminator, where the slope of light is discontinuous (`terminator.py`).

`regions.py` divides the light among them. Each piece of light is evaluated once, and the lens is its transfer function.
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

_FINE_ENOUGH = 2.4
"""Grid points per pixel, over the cutoff of the lens in cycles/px."""
_TILE = 32, 64
"""Rows and columns of a tile of the grid."""
_ACROSS = 30.0
"""Number of grid steps in the radius of a sphere in addition to those that the cutoff of the lens requires."""
_SMALLEST = 2.5
"""Smallest radius of a sphere, px."""
_HIGHEST = 3.3
"""Highest supported cutoff of a lens, cycles/px: 8 points per pixel."""


class Laying(NamedTuple):
    """Arrangement of the light outside the regular points of a grid. Each kind requires a program.

    Attributes:
        lines: lines of the limb.
        patch: size of the patch about the highlight.
    """

    lines: tuple[LimbLines, ...]
    patch: PatchSize


class LightGrid(NamedTuple):
    """Regular grid on which light is placed.

    Attributes:
        x: positions of the columns, at a constant step, px.
        y: positions of the rows, px; if the light is symmetric, starting half a step above the axis.
        widths: widths of the regions.
        taps: weights of single points of light.
        symmetric: True if only the upper half is computed, for symmetric light.
    """

    x: np.ndarray
    y: np.ndarray
    widths: RegionWidths
    taps: Taps
    symmetric: bool

    @classmethod
    def of(cls, x: np.ndarray, y: np.ndarray, highest: float, *, symmetric: bool = False) -> LightGrid:
        """Build the grid for a band up to `highest`, cycles/px."""
        per_px = 1 / abs(x[1] - x[0])
        return cls(x, y, RegionWidths.above(per_px - highest), Taps.below(highest / per_px), symmetric)

    def laying(self, scene: Scene) -> Laying:
        """Choose the arrangement of the light of a scene; its parameters must be concrete, apart from their derivatives."""
        known = without_derivatives(scene)
        radius = float(known.sample.radius)
        cosine = np.sqrt(1 - (float(highlight_x(known.sample, known.lamp_angle, known.lamp_nearness)) / radius) ** 2)
        step = abs(self.x[1] - self.x[0])
        sides = [(False, 1), (False, -1), (True, 1), (True, -1)]
        lines = tuple(
            limb_lines(self.x if upright else self.y, radius, self.widths.widest_line, self.taps, upright, side)
            for upright, side in sides[: 3 if self.symmetric else 4]
        )
        turned = scene.turn is not None
        return Laying(lines, patch_size(self.widths, cosine, step, self.taps, self.symmetric, turned))

    def laid(self, scene: Scene, laying: Laying | None = None) -> jax.Array:
        """Compute the light of a scene on the grid, 1/sr, (rows, columns, channels). laying: for parameters that are
        not concrete.
        """
        return _laid(scene, self.x, self.y, (self.widths, self.taps, self.symmetric), laying or self.laying(scene))


def per_px_for(highest: float, radius: float) -> int:
    """Compute the number of grid points per pixel.

    Args:
        highest: frequency up to which the light is used, cycles/px.
        radius: radius of the sphere, px.
    """
    return max(2, int(np.ceil(_FINE_ENOUGH * highest)), int(np.ceil(highest + _ACROSS / radius)))


def margin_of(per_px: int, highest: float) -> float:
    """Compute the margin of a grid beyond the sphere, px."""
    return (Taps.below(highest / per_px).reach + 2) / per_px


def serves(sample: Curved, elongation: float, highest: float) -> bool:
    """Check whether grids apply: a sphere in front of a distant camera, with round lobes.

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
    scene: Scene,
    x: AnyArray,
    y: AnyArray,
    kind: tuple[RegionWidths, Taps, bool],
    laying: Laying,
) -> jax.Array:
    widths, taps, symmetric = kind
    x, y = jnp.asarray(x), jnp.asarray(y)
    regions = Regions.of(scene, widths)
    grid = _smooth_part(regions, x, y)
    for served in laying.lines:
        across, along = (x, y) if served.upright else (y, x)
        grid = lay_limb(grid, regions, served, across, along, taps)
    grid = remove_kink(grid, regions, False, y, x)
    grid = remove_kink(grid, regions, True, x, y)
    return lay_highlight(grid, regions, laying.patch, x, y, taps, symmetric)


def _smooth_part(regions: Regions, x: jax.Array, y: jax.Array) -> jax.Array:
    """Compute the light of the regular points, tile by tile, because most of an image is dark."""
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
