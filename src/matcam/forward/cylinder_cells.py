"""What a rig records of the cells of a table on a cylinder, which shows the normals of one line (docs/model.md 3).

A cell asks for a normal beside the plane of camera and lamp. A sphere shows it there; a cylinder shows it when the lamp is
turned about the optical axis, until the normal lies across the cylinder's axis. So each cell has a lamp of its own, and its
record is an integral over one line: along the axis the light is the same all over.

    R(x) = integral over the visible, lit line of  k(x - radius sin u) rho cos_i cos_o radius du,

Places away from the highlight and from the ends of the light take Gauss's rule of the kernel. Elsewhere panels in u shrink
towards the place closest to the half vector, on the lobe's own scale, and end where a sharp pixel does.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.errors import ArgumentError
from matcam.core.grid import cosines, merl_grid
from matcam.core.jax import AnyArray, is_concrete, jax, jnp
from matcam.core.programs import kept_program
from matcam.core.shading import Vector, shading
from matcam.core.workspace import Workspace
from matcam.forward.cells_in_pictures import cell_sampling
from matcam.forward.integral.blur import Blur, BlurTerms, blur_of, groups_of
from matcam.forward.integral.recording import in_batches
from matcam.material.material import Material
from matcam.numerics.approximation import graded_nodes
from matcam.rigs import UNKNOWN, Rig
from matcam.sample.curved import Cylinder, Sphere

_REACH = 6.2
"""How far a kernel is followed, in standard deviations."""
_AWAY = 9.0
"""Angle from the half vector, in the kernel's standard deviations, from which the light is smooth on the kernel's scale."""
_GRADED, _EVEN, _ORDER = 6, 4, 6
_ENDS = 3.0
"""Width of the panel at the ends of the light, where masking sets in, in the lobe's own scale."""
_TURN = 1e-9
"""Sine of half an azimuth up to which it is a whole turn, and none."""
_SMOOTH, _ROUGH = 4096, 256
"""Places at a time: as many nodes as fit into a processor's cache."""


class LinePlaces(NamedTuple):
    """Hold places on the line that a cylinder shows, arrays of one shape; each has a lamp of its own.

    Attributes:
        x: px from the axis.
        lamp: direction to the lamp, three arrays.
    """

    x: np.ndarray
    lamp: Vector


class CylinderCells(NamedTuple):
    """Hold the cells of a table on a cylinder. Arrays over (theta_h, theta_d, phi_d, way).

    Attributes:
        places: those that are seen.
        flat_index: their positions in the flattened arrays.
        cos_i: cosine of the light at each cell.
        seen: whether a cell is seen.
    """

    places: LinePlaces
    flat_index: np.ndarray
    cos_i: np.ndarray
    seen: np.ndarray


def check_cylinder(rig: Rig, azimuth: float = 0.0) -> None:
    """Raise ArgumentError for a rig whose cylinder no table can be recorded of.

    rig: with a cylinder. azimuth: of the lamp that was asked for, rad.
    """
    if not rig.sample.distant or rig.lamp.nearness is not None:  # type: ignore[attr-defined]
        raise ArgumentError(
            "a cylinder's table needs a distant camera and lamp: before a near one light changes along it"
        )
    if is_concrete(rig.lamp_radius) and float(rig.lamp_radius) > 0:
        raise ArgumentError(
            f"a cylinder's table needs a lamp without a disc, got a radius of {float(rig.lamp_radius):g} rad"
        )
    if any(abs(np.sin((turned or 0.0) / 2)) > _TURN for turned in (azimuth, rig.lamp_azimuth)):
        raise ArgumentError(
            "a cylinder's table has a lamp of its own for every cell: the lamp's azimuth must be left out"
        )
    if rig.cell_value not in ("centre", "edge", UNKNOWN):
        raise ArgumentError(
            f"cells of '{rig.cell_value}' need a sphere: on a cylinder each cell has a picture of its own; cell_value must be "
            "'centre' or 'edge'"
        )


def cylinder_table(material: Material, rig: Rig, workspace: Workspace) -> tuple[jax.Array, np.ndarray]:
    """Return the table that a rig records of a material on a cylinder, (90, 90, 180, channels), 1/sr, and its pixels' counts.

    Differentiable in material and camera. NaN where no way shows a cell. Each way that shows one is a pixel.
    """
    key = float(jax.lax.stop_gradient(rig.sample.radius)), rig.cell_value, rig.crop  # type: ignore[attr-defined]
    cells = workspace.remember("cylinder cells", key, lambda: cylinder_cells(rig), most=1)
    radiance = line_record(material, rig, cells.places)
    flat = jnp.zeros((cells.seen.size, radiance.shape[1])).at[cells.flat_index].set(radiance)
    ways = flat.reshape(*cells.seen.shape, -1) / np.where(cells.seen, cells.cos_i, 1.0)[..., None]
    count = cells.seen.sum(-1)[..., None]
    return jnp.where(count > 0, ways.sum(3) / np.maximum(count, 1), jnp.nan), 1.0 * count[..., 0]


def cylinder_cells(rig: Rig) -> CylinderCells:
    """Return where a rig's cylinder shows the cells of a table."""
    grid = merl_grid(cell_sampling(rig.cell_value))
    angles = np.meshgrid(*grid, [0.0, np.pi], indexing="ij")
    theta_h, theta_d, phi_d = angles[0], angles[1], angles[2] + angles[3]
    cos_i, cos_o = (np.asarray(c) for c in cosines(theta_h, theta_d, phi_d))
    seen = (cos_i > 0) & (cos_o > 0)
    places = line_places(float(rig.sample.radius), theta_h, theta_d, phi_d)  # type: ignore[attr-defined]
    if rig.crop is not None:
        seen &= np.abs(places.x) <= rig.crop[1] / 2
    index = np.flatnonzero(seen)
    x, *lamp = (a.ravel()[index] for a in (places.x, *places.lamp))
    return CylinderCells(LinePlaces(x, tuple(lamp)), index, cos_i, seen)  # type: ignore[arg-type]


def line_places(radius: float, theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray) -> LinePlaces:
    """Return where a cylinder of a radius, px, shows half and difference angles, and under which lamps."""
    on_sphere = jax.jit(lambda *angles: Sphere(radius).place(*angles))(theta_h, theta_d, phi_d)
    x, y, lamp_angle = (np.asarray(a) for a in on_sphere)
    off = np.hypot(x, y)
    cosine = np.where(off > 0, x / np.where(off > 0, off, 1.0), 1.0)
    sine = np.where(off > 0, -y / np.where(off > 0, off, 1.0), 0.0)
    sin = np.sin(lamp_angle)
    return LinePlaces(off, (sin * cosine, sin * sine, np.cos(lamp_angle)))


def line_record(material: Material, rig: Rig, places: LinePlaces) -> jax.Array:
    """Return the radiance that places on a cylinder record under unit irradiance, 1/sr, (places, channels)."""
    cylinder, blur = rig.sample, blur_of(rig, in_discs=True)
    assert isinstance(cylinder, Cylinder)
    elongation = np.asarray(float(material.elongation))
    record = jnp.zeros((places.x.size, _channels(material, cylinder)))
    for terms, _ in groups_of(blur, cylinder):  # narrow terms need nodes that wide ones would not have
        smooth = _smooth_places(cylinder, blur, terms, places, float(elongation))
        for which, part in ((smooth, _record_smooth), (~smooth, _record_rough)):
            index = np.flatnonzero(which)
            if index.size:
                own = jax.tree.map(lambda a, index=index: a[index], places)
                record = record.at[index].add(part(material, cylinder, BlurTerms(blur, terms), own, elongation))
    return record


def _smooth_places(
    cylinder: Cylinder, blur: Blur, terms: tuple[int, ...], places: LinePlaces, elongation: float
) -> np.ndarray:
    """Say which places see no end of the light, no highlight, and one kernel, (places,)."""
    cylinder, blur = jax.lax.stop_gradient((cylinder, blur))
    if float(blur.aperture) > 0:  # what is out of focus changes the kernel from place to place
        return np.zeros(places.x.shape, dtype=bool)
    radius, half = float(cylinder.radius), float(blur.pixel.half_width)
    widest = float(np.max(np.asarray(blur.stds)[list(terms)]))
    std = np.hypot(widest, half / np.sqrt(3))
    reach = _REACH * widest + half
    u = np.arcsin(places.x / radius)
    first, last = (np.arcsin(np.clip((places.x + side * reach) / radius, -1, 1)) for side in (-1, 1))
    low, high, peak, _ = (np.asarray(a) for a in _line(places.lamp))
    inside = (np.abs(places.x) + reach < radius) & (first > low) & (last < high)
    across = np.asarray(places.lamp[1]) / np.sqrt(2 * (1 + np.asarray(places.lamp[2])))  # the half vector's y
    nearest = np.clip(peak, first, last)
    away = np.hypot(across, np.sin(nearest - peak))
    return np.asarray(inside & (away > _AWAY * elongation * std / (radius * np.cos(u))))


def _line(lamp: Vector) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Return the ends of what is visible and lit in u, where it is closest to the half vector, and by how much it misses it."""
    middle = jnp.arctan2(lamp[0], lamp[2])
    low, high = jnp.maximum(-jnp.pi / 2, middle - jnp.pi / 2), jnp.minimum(jnp.pi / 2, middle + jnp.pi / 2)
    half = lamp[0], lamp[1], lamp[2] + 1
    return low, high, jnp.arctan2(half[0], half[2]), jnp.abs(half[1]) / jnp.sqrt(2 * (1 + lamp[2]))


def _sent(material: Material, cylinder: Cylinder, u: jax.Array, lamp: Vector) -> jax.Array:
    """Return rho cos_i cos_o at normals, channels last, 1/sr."""
    element = cylinder.surface(u, jnp.zeros(()))
    light = material.reflected(shading(element.normal, element.tangent, lamp, element.view))
    return light if light.ndim > u.ndim else light[..., None]


def _channels(material: Material, cylinder: Cylinder) -> int:
    lamp = jnp.zeros(1), jnp.zeros(1), jnp.ones(1)
    return jax.eval_shape(lambda: _sent(material, cylinder, jnp.zeros(1), lamp)).shape[-1]


@kept_program
def _record_smooth(
    material: Material, cylinder: Cylinder, through: BlurTerms, places: LinePlaces, _: AnyArray
) -> jax.Array:
    blur = through.blur

    def integral(at: LinePlaces) -> jax.Array:
        x, *lamp = (a[:, None] for a in (at.x, *at.lamp))
        total: jax.Array | float = 0.0
        for term in through.terms:
            offset, weight = blur.rule(term, jnp.zeros(()))
            sin_u = (x + offset) / cylinder.radius
            light = _sent(material, cylinder, jnp.arcsin(sin_u), tuple(lamp))  # type: ignore[arg-type]
            # per px of the picture: over the cosine of the view
            share = blur.weights[term] * weight / jnp.sqrt(1 - sin_u**2)
            total += jnp.sum(light * share[..., None], axis=1)
        return jnp.asarray(total)

    return in_batches(integral, (places,), _SMOOTH)


@kept_program
def _record_rough(
    material: Material, cylinder: Cylinder, through: BlurTerms, places: LinePlaces, elongation: AnyArray
) -> jax.Array:
    blur, finest, radius = through.blur, material.finest, cylinder.radius
    pixel, widest = blur.pixel.half_width, jnp.max(blur.stds[np.array(through.terms)])

    def integral(at: LinePlaces) -> jax.Array:
        *lit, peak, miss = (a[:, None] for a in _line(at.lamp))
        x = jnp.asarray(at.x)[:, None]
        reach = _REACH * widest + pixel
        discs = [  # the wider of those about the pixel
            blur.spread(cylinder, jnp.sqrt(1 - jnp.clip((x + side * reach) / radius, -1, 1) ** 2), jnp.zeros(())).disc
            for side in (-1, 0, 1)
        ]
        reach = reach + jnp.maximum(jnp.maximum(*discs[:2]), discs[2])

        def along(column: jax.Array) -> jax.Array:
            return jnp.clip(jnp.arcsin(jnp.clip(column / radius, -1, 1)), *lit)

        low, high = along(x - reach), along(x + reach)
        middle = jnp.clip(peak, low, high)
        centre = radius * jnp.sin(middle)
        steps = np.concatenate([[-1.0, 1.0], np.arange(1, _EVEN) / _EVEN])
        layer = _ENDS * finest
        sides = []
        for end in (low, high):
            here = radius * jnp.sin(end)
            cuts = along(jnp.concatenate([x + steps[:2] * pixel, centre + (here - centre) * steps[2:]], axis=1))
            cuts = jnp.concatenate([middle, cuts, low + layer, high - layer, end], axis=1)
            way = jnp.where(end < middle, -1.0, 1.0)
            borders = jnp.sort(jnp.clip(way * (cuts - middle), 0.0, jnp.abs(end - middle)), axis=1)
            # a lobe that is long across the line is narrow on it however far the line misses it
            scale = jnp.sqrt(finest**2 + (miss**2 + (middle - peak) ** 2) / elongation**2)
            distance, weight = graded_nodes(borders, scale[:, 0], _GRADED, _ORDER)
            sides.append((middle + way * distance, weight))
        # an integral does not depend on where its nodes are
        u, weight = (jax.lax.stop_gradient(jnp.concatenate(parts, axis=1)) for parts in zip(*sides, strict=True))
        light = _sent(material, cylinder, u, tuple(a[:, None] for a in at.lamp))  # type: ignore[arg-type]
        offset, spread = x - radius * jnp.sin(u), blur.spread(cylinder, jnp.cos(u), jnp.zeros(()))
        # light is the same all along the axis: of each chord its column counts
        kernel = sum(
            blur.weights[j] * blur.through_disc(j, spread, lambda along, _: along(offset)) for j in through.terms
        )
        return radius * jnp.sum(light * (kernel * weight)[..., None], axis=1)

    return in_batches(integral, (places,), _ROUGH)
