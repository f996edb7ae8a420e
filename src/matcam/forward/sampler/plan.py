"""Plan of a record: the quadrature nodes of each pixel.

Number and positions of the nodes depend on the rig and on the narrowest scale of the lobe. The plan is kept constant
while the parameters of material and camera vary. The record is then a smooth function of these parameters.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from matcam.core.jax import jax, jnp
from matcam.core.programs import kept_program
from matcam.core.threads import available_cores, in_order
from matcam.forward.integral.blur import Imaging
from matcam.forward.integral.blur_groups import BlurGroup, groups_of
from matcam.forward.integral.residual_at_limb import LimbRule, limb_rule
from matcam.forward.integral.scene import Turn
from matcam.forward.sampler.arc_nodes import nodes_on_arcs
from matcam.forward.sampler.arcs import CHUNK
from matcam.forward.sampler.circle_arcs import CircleArcs
from matcam.forward.sampler.circles import COARSEST, lay_circles
from matcam.forward.sampler.cylinder_arcs import CrossArcs, arcs_across, smooth_on_cylinder
from matcam.forward.sampler.windows import GRAZING, SphereView, Windows
from matcam.numerics.blocks import in_blocks, in_calls
from matcam.sample.curved import Cylinder, Sphere

_AROUND = np.pi / 8 * np.arange(16)
"""Azimuths, rad, of positions around a pixel that are visible and lit if the radiance around the pixel is smooth."""
_NO_CRESCENT = 0.6
"""Share of the support radius of a residual. If the surface is lit everywhere within this distance, the radiance is smooth
up to the limb.
"""


class RecordPositions(NamedTuple):
    """Pixel centres in images of a sample, arrays of shape (positions,).

    Attributes:
        x: position to the right of the optical axis, px.
        y: position above the optical axis, px.
        lamp_angle: angle between lamp and optical axis, rad.
        azimuth: azimuth of the lamp of each position, rad; None: every lamp is towards +x.
        picture: index of the image; None: irrelevant.
    """

    x: np.ndarray
    y: np.ndarray
    lamp_angle: np.ndarray
    azimuth: np.ndarray | None = None
    picture: np.ndarray | None = None

    def at(self, index: np.ndarray) -> RecordPositions:
        return self._replace(**{name: np.asarray(a)[index] for name, a in self._asdict().items() if a is not None})

    @property
    def turn(self) -> Turn | None:
        """Cosine and sine of the azimuth; None if every lamp is towards +x."""
        return None if self.azimuth is None else Turn(np.cos(self.azimuth), np.sin(self.azimuth))


class ArcRows(NamedTuple):
    """Arcs in ascending order of their numbers of nodes, arrays over (arcs,).

    Attributes:
        nodes: number of nodes.
        position: index of the pixel.
        window: index of the pixel among the pixels with arcs.
        angle: angle of the circle from its axis, rad.
        weight: weight of the circle, see `Circles`, times half the length of the arc.
        middle: azimuth of the middle of the arc, rad.
        half: half length of the arc, rad.
    """

    nodes: np.ndarray
    position: np.ndarray
    window: np.ndarray
    angle: np.ndarray
    weight: np.ndarray
    middle: np.ndarray
    half: np.ndarray

    def at(self, index: np.ndarray | slice) -> ArcRows:
        return ArcRows(*(a[index] for a in self))

    def on_circles(self, frames: np.ndarray) -> CircleArcs:
        """Combine the arcs with the frames of their circles. frames: see `PlanPart`."""
        vectors = frames[self.window].T
        return CircleArcs(tuple(tuple(vectors[n : n + 3]) for n in (0, 3, 6)), *self[3:])


class PlanPart(NamedTuple):
    """Plan for the terms of a blur that share a scale.

    Attributes:
        terms: indices of the terms.
        smooth: indices of pixels with smooth radiance.
        limb: indices of pixels with the limb in the support of the residual of a lens.
        limb_rule: quadrature rule of the pixels in `limb`; None: there are no such pixels.
        frames: frame of the circles of each pixel with arcs, (pixels, 9): axis, direction of azimuth 0, and of pi/2; empty
            for a cylinder.
        arcs: arcs of these pixels with Gauss-Legendre nodes.
        even_arcs: arcs of these pixels with equally spaced nodes. The integrand vanishes at the ends of these arcs.
    """

    terms: tuple[int, ...]
    smooth: np.ndarray
    limb: np.ndarray
    limb_rule: LimbRule | None
    frames: np.ndarray
    arcs: ArcRows | CrossArcs
    even_arcs: ArcRows | CrossArcs


@dataclass(frozen=True, eq=False)
class RecordPlan:
    """Integration plan of a record: its positions, and one part for each scale of the blur."""

    positions: RecordPositions
    parts: tuple[PlanPart, ...]


def record_plan(imaging: Imaging, positions: RecordPositions, finest: float, elongation: float = 1.0) -> RecordPlan:
    """Compute the plan of a record.

    Args:
        imaging: sample, blur and inverse distance of the lamp.
        positions: positions to record.
        finest: narrowest scale of the lobe, rad.
        elongation: elongation of the lobe, no unit: factor of the distance from a highlight within which the radiance
            may vary on a smaller scale than the kernel. Default: 1, an isotropic lobe.

    Returns:
        The plan. It is valid for materials whose lobes are not narrower than `finest`, and for cameras whose parameters
        differ little from those of `imaging`.

    Raises:
        ArgumentError: the call is inside jax.jit, or the sample is smaller than the blur.
    """
    imaging = jax.lax.stop_gradient(imaging)
    groups = groups_of(imaging.blur, imaging.sample)
    part = _part_on_cylinder if isinstance(imaging.sample, Cylinder) else _part
    return RecordPlan(positions, tuple(part(imaging, group, positions, finest, elongation) for group in groups))


def rough_pixels(imaging: Imaging, positions: RecordPositions, elongation: float) -> np.ndarray:
    """Find pixels of a cylinder that require arcs. elongation: see `record_plan`."""
    scales = [group.scale for group in groups_of(imaging.blur, imaging.sample)]
    smooth = [
        smooth_on_cylinder(imaging, _pixels(imaging, positions, scale.reach), scale.near * elongation)
        for scale in scales
    ]
    return ~np.all(smooth, axis=0)


def graded_for(finest: float, imaging: Imaging) -> float:
    """Round the scale of a lobe, rad, down to one of few values, so that most materials share a plan."""
    return min(float(np.exp2(np.floor(np.log2(finest)))), COARSEST / float(imaging.sample.radius))


def _part(imaging: Imaging, group: BlurGroup, positions: RecordPositions, finest: float, elongation: float) -> PlanPart:
    scale = group.scale
    lamp = np.zeros(()) if imaging.lamp_nearness is None else np.asarray(imaging.lamp_nearness)
    view = SphereView(float(imaging.sample.radius), float(imaging.sample.nearness), float(lamp))
    pixels = _pixels(imaging, positions, scale.reach)
    clear, dark = _clear(imaging, pixels, scale.margin), _dark(view, pixels)
    near, crowded = _near(view, pixels, scale.near * elongation), _crowded(view, pixels)
    smooth, limb, rule = clear & ~near & ~crowded, np.zeros(positions.x.size, dtype=bool), None
    if imaging.blur.is_residual(group.terms[0]):
        rule = None if imaging.blur.varies else limb_rule(imaging.blur.residual, view.radius)  # type: ignore[arg-type]
        if rule is not None:
            limb, dim = _residual_beside(imaging, view, pixels, ~dark & ~near & ~smooth)
            smooth |= dim
    rough = np.flatnonzero(~dark & ~smooth & ~limb)
    frames, *found = _arcs(view, pixels.at(rough), scale.fineness, finest, elongation)
    arcs, even_arcs = (some._replace(position=rough[some.window]) for some in found)
    return PlanPart(group.terms, np.flatnonzero(smooth), np.flatnonzero(limb), rule, frames, arcs, even_arcs)


def _part_on_cylinder(
    imaging: Imaging, group: BlurGroup, positions: RecordPositions, finest: float, elongation: float
) -> PlanPart:
    scale, nothing = group.scale, np.zeros(0, dtype=int)
    pixels = _pixels(imaging, positions, scale.reach)
    smooth = smooth_on_cylinder(imaging, pixels, scale.near * elongation)
    rough = np.flatnonzero(~smooth)
    found = arcs_across(imaging, pixels.at(rough), scale.fineness, finest, elongation)
    arcs, even_arcs = (some._replace(position=rough[some.position]) for some in found)
    return PlanPart(group.terms, np.flatnonzero(smooth), nothing, None, np.zeros((0, 9)), arcs, even_arcs)


def _pixels(imaging: Imaging, positions: RecordPositions, half: float) -> Windows:
    """Build the windows of pixels. half: half the side of a window, px."""
    size = positions.x.size
    turn = positions.turn or Turn(np.ones(size), np.zeros(size))  # type: ignore[arg-type]
    lamps, which = np.unique(positions.lamp_angle, return_inverse=True)
    on_sphere = size and isinstance(imaging.sample, Sphere)
    peaks = np.asarray(_highlights(imaging, lamps))[which] if on_sphere else np.zeros(size)
    x, y = (np.asarray(a, dtype=float) for a in positions[:2])
    return Windows(
        x, y, positions.lamp_angle, peaks, np.asarray(turn.cosine), np.asarray(turn.sine), np.full((2, size), half)
    )


def _highlights(imaging: Imaging, lamps: np.ndarray) -> np.ndarray:
    """Compute the angle between the normal of the highlight and the optical axis for each lamp, rad."""
    if imaging.sample.distant and imaging.lamp_nearness is None:
        return lamps / 2
    (found,) = in_calls(_highlight_blocks, (lamps,), imaging)
    return found


@kept_program
def _highlight_blocks(used: jax.Array, rows: tuple[jax.Array, ...], imaging: Imaging) -> tuple[jax.Array]:
    return (in_blocks(lambda lamp: imaging.sample.highlight(lamp[0], imaging.lamp_nearness), used, rows),)


def _near(view: SphereView, pixels: Windows, distance: float) -> np.ndarray:
    """Find the pixels in a square around the highlight. distance: half the side of the square, px."""
    peak = np.stack([np.sin(pixels.peak), np.zeros(pixels.x.size), np.cos(pixels.peak)])
    return pixels._replace(half=np.full_like(pixels.half, distance)).contains(view, peak)


def _crowded(view: SphereView, pixels: Windows) -> np.ndarray:
    """Find the pixels whose angular distance from the highlight is below the angular size of their kernel on the sphere."""
    n_x, n_y, n_z = view.normals(*pixels.to_lamp(pixels.x, pixels.y))
    sine, cosine = np.sin(pixels.peak), np.cos(pixels.peak)
    between = np.arctan2(np.hypot(n_x * cosine - n_z * sine, n_y), n_x * sine + n_z * cosine)
    return between < 2 * pixels.half[0] / (view.radius * np.maximum(n_z - view.camera, GRAZING))


def _dark(view: SphereView, pixels: Windows) -> np.ndarray:
    """Find pixels whose kernel certainly contains no visible and lit surface."""
    x, y = pixels.to_lamp(pixels.x, pixels.y)
    off, corner = np.hypot(x, y), np.sqrt(2) * pixels.half[0]
    sine, cosine = np.sin(pixels.lamp), np.cos(pixels.lamp)
    inner, outer = (view.normals(np.maximum(off + side * corner, 0.0), 0 * off)[2] for side in (-1, 1))
    depth = np.where(cosine > 0, inner, outer)
    # the largest n . l: x / stretch (1 - q n_z) is at most x / stretch (1 - q outer)
    across = np.minimum(np.maximum(x + corner, 0.0) / view.stretch * (1 - view.camera * outer), 1.0)
    return (off - corner > view.radius) | (across * sine + depth * cosine < view.lamp)


def _clear(imaging: Imaging, pixels: Windows, distance: float) -> np.ndarray:
    """Find pixels whose surroundings within a distance, px, are visible and lit."""
    if not pixels.x.size:
        return np.zeros(0, dtype=bool)
    x, y = pixels.to_lamp(pixels.x, pixels.y)
    (found,) = in_calls(_clear_blocks, (x, y, pixels.lamp), imaging, np.asarray(distance))
    return found


@kept_program
def _clear_blocks(
    used: jax.Array, rows: tuple[jax.Array, ...], imaging: Imaging, distance: jax.Array
) -> tuple[jax.Array]:
    sample, nearness = imaging.sample, 0.0 if imaging.lamp_nearness is None else imaging.lamp_nearness

    def block(arguments):  # type: ignore[no-untyped-def]
        x, y, lamp = (a[:, None] for a in arguments)
        element, visible = sample.at(x + distance * np.cos(_AROUND), y + distance * np.sin(_AROUND))
        up = element.normal[0] * jnp.sin(lamp) + element.normal[2] * jnp.cos(lamp)
        return jnp.all(visible & (up > nearness), axis=1)

    return (in_blocks(block, used, rows),)


def _residual_beside(
    imaging: Imaging, view: SphereView, pixels: Windows, positions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Select two groups of pixels whose residual requires no arcs.

    The support of the residual contains the limb for the first group, and only smooth radiance for the second group.

    A terminator, where the radiance starts at 0, changes the contribution of the residual by at most 2e-5 of the peak. A
    terminator near the limb matters only if the lit part is a thin crescent.
    """
    index = np.flatnonzero(positions)
    limb, dim = np.zeros_like(positions), np.zeros_like(positions)
    own, reach = pixels.at(index), float(pixels.half.max(initial=0.0))
    off = np.hypot(own.x, own.y)
    # positions beyond the limb are replaced by the nearest ones inside
    inside = np.minimum(1.0, (view.radius - _NO_CRESCENT * reach) / np.maximum(off, 1e-9))
    inner = own._replace(x=own.x * inside, y=own.y * inside)
    bright, sees = _clear(imaging, inner, _NO_CRESCENT * reach * (1 - 1e-9)), off > view.radius - reach
    limb[index], dim[index] = sees & bright, ~sees
    return limb, dim


def _arcs(
    view: SphereView, windows: Windows, fineness: float, finest: float, elongation: float
) -> tuple[np.ndarray, ArcRows, ArcRows]:
    """Compute the fields `frames`, `arcs` and `even_arcs` of `PlanPart` for windows."""

    def chunk(begin: int) -> tuple[np.ndarray, ...]:
        own = windows.at(slice(begin, begin + CHUNK))
        layout = lay_circles(view, own, finest, fineness)
        circle, middle, half, _ = layout.arcs
        window, angle, weight = (a[circle] for a in layout.circles)
        frames = np.concatenate(layout.frame).T
        nodes, evenly = nodes_on_arcs(view, own, layout, fineness, elongation)
        return frames, evenly, nodes, begin + window, angle, weight * half, middle, half

    nothing = np.zeros(0, dtype=int)
    found = [(np.zeros((0, 9)), nothing.astype(bool), nothing, nothing, *[np.zeros(0)] * 4)]
    found += in_order(chunk, range(0, windows.x.size, CHUNK), available_cores())
    frames, evenly, nodes, window, *others = (np.concatenate(parts) for parts in zip(*found, strict=True))
    arcs, order = ArcRows(nodes, window, window, *others), np.argsort(nodes, kind="stable")
    even = evenly[order]
    return frames, arcs.at(order[~even]), arcs.at(order[even])
