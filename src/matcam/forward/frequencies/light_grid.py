"""The light that a sphere sends, on an even grid whose transform is right for all that a lens passes.

A sum over points of light an even step apart is exact but for frequencies that come back as others: those beyond one over the
step, less the lens's highest. Light has hardly any of them but in three places, which are laid on the grid by themselves:

- the limb, where it ends (`limb_lines.py`);
- the highlight, whose lobe may be narrower than a step (`highlight_patch.py`);
- the terminator, where it reaches 0 with a bend (`terminator.py`).

`regions.py` says what belongs to which. So each piece of light is asked for once, and the lens is its transfer function.
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
from matcam.forward.frequencies.terminator import mend_bend
from matcam.forward.integral.scene import Scene, highlight_x
from matcam.sample.curved import Sphere
from matcam.sample.shape import Curved

_FINE_ENOUGH = 2.4
"""Points a pixel, over the lens's highest frequency in cycles/px."""
_TILE = 32, 64
"""Rows and columns of the grid that are looked at together."""
_ACROSS = 30.0
"""Steps of the grid in a sphere's radius, at least, beyond those that the lens's highest frequency asks for."""
_SMALLEST = 2.5
"""Least radius of a sphere, px."""
_HIGHEST = 3.3
"""Highest frequency that a lens may pass, cycles/px: 8 points a pixel."""


class Laying(NamedTuple):
    """Say where light is laid that does not belong to the grid's own points. Each kind is a program.

    Attributes:
        lines: those of the limb.
        patch: size of that about the highlight.
    """

    lines: tuple[LimbLines, ...]
    patch: PatchSize


class LightGrid(NamedTuple):
    """Say how light is laid on a grid.

    Attributes:
        x: places of the columns, an even step apart, px.
        y: places of the rows, px; from half a step upwards where they are alike.
        widths: of the regions.
        taps: how single points of light are laid.
        alike: whether only the upper half is laid, of light that is the same above and below.
    """

    x: np.ndarray
    y: np.ndarray
    widths: RegionWidths
    taps: Taps
    alike: bool

    @classmethod
    def of(cls, x: np.ndarray, y: np.ndarray, highest: float, *, alike: bool = False) -> LightGrid:
        """Return the grid for what lets pass frequencies up to `highest`, cycles/px."""
        per_px = 1 / abs(x[1] - x[0])
        return cls(x, y, RegionWidths.above(per_px - highest), Taps.below(highest / per_px), alike)

    def laying(self, scene: Scene) -> Laying:
        """Return how the light of a scene is laid; its numbers must be known, but for their derivatives."""
        known = without_derivatives(scene)
        radius = float(known.sample.radius)
        cosine = np.sqrt(1 - (float(highlight_x(known.sample, known.lamp_angle, known.lamp_nearness)) / radius) ** 2)
        step = abs(self.x[1] - self.x[0])
        sides = [(False, 1), (False, -1), (True, 1), (True, -1)]
        lines = tuple(
            limb_lines(self.x if upright else self.y, radius, self.widths.widest_line, self.taps, upright, side)
            for upright, side in sides[: 3 if self.alike else 4]
        )
        turned = scene.turn is not None
        return Laying(lines, patch_size(self.widths, cosine, step, self.taps, self.alike, turned))

    def laid(self, scene: Scene, laying: Laying | None = None) -> jax.Array:
        """Return the light of a scene, 1/sr, (rows, columns, channels). laying: how, where its numbers are not known."""
        return _laid(scene, self.x, self.y, (self.widths, self.taps, self.alike), laying or self.laying(scene))


def per_px_for(highest: float, radius: float) -> int:
    """Return how many points a pixel a grid needs.

    Args:
        highest: frequency up to which its light is looked at, cycles/px.
        radius: of the sphere, px.
    """
    return max(2, int(np.ceil(_FINE_ENOUGH * highest)), int(np.ceil(highest + _ACROSS / radius)))


def margin_of(per_px: int, highest: float) -> float:
    """Return how far a grid must reach beyond the sphere, px."""
    return (Taps.below(highest / per_px).reach + 2) / per_px


def serves(sample: Curved, elongation: float, highest: float) -> bool:
    """Tell whether light is laid on grids: a sphere's before a distant camera, of round lobes.

    Args:
        sample: what is photographed.
        elongation: of the material's lobe, no unit.
        highest: frequency that the lens lets pass, cycles/px.
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
    widths, taps, alike = kind
    x, y = jnp.asarray(x), jnp.asarray(y)
    regions = Regions.of(scene, widths)
    grid = _smooth_part(regions, x, y)
    for served in laying.lines:
        across, along = (x, y) if served.upright else (y, x)
        grid = lay_limb(grid, regions, served, across, along, taps)
    grid = mend_bend(grid, regions, False, y, x)
    grid = mend_bend(grid, regions, True, x, y)
    return lay_highlight(grid, regions, laying.patch, x, y, taps, alike)


def _smooth_part(regions: Regions, x: jax.Array, y: jax.Array) -> jax.Array:
    """Return the light of the grid's own points, tile by tile: most of a picture is dark."""
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
