"""Response at the peak on a curved sample with its limb: recorded peak over true peak (docs/model.md 3)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.errors import ArgumentError
from matcam.core.jax import AnyArray, is_concrete, jax, jnp
from matcam.core.programs import kept_program
from matcam.forward.integral.blur import BlurTerms, Imaging, imaging_of
from matcam.forward.integral.blur_groups import groups_of
from matcam.forward.integral.cylinder_discs import LinePlaces, line_record, places_under
from matcam.forward.integral.cylinder_record import light_at
from matcam.forward.integral.discs import disc_fineness
from matcam.forward.integral.integrals import HighlightPanels, record_around, record_around_turned
from matcam.forward.integral.scene import Scene, Turn, highlight_x
from matcam.lamp.lamps import Lamp, LampPoint, disc_of, lamp_points
from matcam.material.masking import Masking
from matcam.material.microfacet import Microfacet
from matcam.material.ndf.distribution import SlopeDistribution
from matcam.rigs import Rig
from matcam.sample.curved import Cylinder
from matcam.sample.shape import Curved, Flat

_EVEN = 6
"""Number of equal panels of the integral about an exact peak in focus."""


def exact_response(rig: Rig, ndf: SlopeDistribution, theta: AnyArray, masking: Masking) -> jax.Array:
    """Compute recorded over true peak on the curved sample; theta: (n,)."""
    theta = jnp.asarray(theta)
    if isinstance(rig.sample, Flat):
        return jnp.ones_like(theta)
    if not isinstance(rig.sample, Curved):
        raise ArgumentError(
            f"an exact peak needs a Sphere, a Cylinder or a Flat sample, not a {type(rig.sample).__name__}"
        )
    imaging = imaging_of(rig)
    material = Microfacet(ndf, 1.0, masking=masking)
    disc = disc_of(rig.lamp) > 0
    groups = groups_of(imaging.blur, imaging.sample, turned=disc)
    # lengths as arrays, so that all rigs of a kind share a program
    reaches = jnp.asarray([group.scale.reach for group in groups])
    terms = tuple(BlurTerms(imaging.blur, group.terms) for group in groups)
    # the disc of a lens extends beyond its blur, which is the scale of its border
    finer = max(group.scale.reach / group.scale.reach_in_focus for group in groups)
    even = _EVEN * int(np.exp2(np.ceil(np.log2(finer))))
    if not disc:
        return _responses(material, imaging, terms, reaches, theta, even)
    if not is_concrete(theta):
        raise ArgumentError("the source disc selects the integration nodes: call this outside of jax.jit and vmap")
    lamps = np.asarray(imaging.sample.lamp_angle(theta, rig.lamp.nearness))
    if isinstance(rig.sample, Cylinder):
        return _responses_on_cylinder(material, rig, lamps)
    fineness = disc_fineness(rig, imaging, lamps, material)
    points = (_sampled_lamp(rig.lamp, *one) for one in zip(lamps, fineness, strict=True))
    return jnp.stack([_response_under_disc(material, imaging, terms, reaches, point, even) for point in points])


def _responses_on_cylinder(material: Microfacet, rig: Rig, lamp_angle: np.ndarray) -> jax.Array:
    """Compute recorded over true peak on a cylinder under a source disc."""
    sample, near = rig.sample, rig.lamp.nearness
    assert isinstance(sample, Cylinder)
    x = np.asarray(highlight_x(sample, jnp.asarray(lamp_angle), near))
    recorded = line_record(material, rig, LinePlaces(x, lamp_angle, np.zeros_like(x)))
    centre = places_under(x, np.zeros_like(x), LampPoint(lamp_angle, np.zeros_like(x), 1.0, 1.0), near)
    return recorded[:, 0] / light_at(material, sample, centre)[:, 0]


class _LampDisc(NamedTuple):
    """Points of a source disc.

    Attributes:
        angle: angle between the disc's centre and the optical axis, rad.
        angles: angles between the points and the optical axis, rad, (points,).
        azimuths: azimuths of the points, rad.
        distances: distances of the points over that of the centre.
        shares: shares of the points in the light; 0 for padding.
    """

    angle: np.ndarray
    angles: np.ndarray
    azimuths: np.ndarray
    distances: np.ndarray
    shares: np.ndarray


def _sampled_lamp(lamp: Lamp, angle: np.ndarray, fineness: float) -> _LampDisc:
    """Sample a source disc by a power of 2 of points, because each number requires a program."""
    points = lamp_points(lamp, angle, 0.0, float(fineness))
    more = (1 << (len(points) - 1).bit_length()) - len(points)
    rows = [(p.angle, p.azimuth, p.distance, p.weight) for p in points]
    rows += [(*rows[-1][:3], 0.0)] * more
    return _LampDisc(np.asarray(angle), *np.array(rows, dtype=np.float64).T)


@kept_program
def _response_under_disc(
    material: Microfacet,
    imaging: Imaging,
    blurs: tuple[BlurTerms, ...],
    reaches: jax.Array,
    disc: _LampDisc,
    even: int,
) -> jax.Array:
    """Compute recorded over true peak under a source disc, the mean over its points."""
    sample, nearness = imaging.sample, imaging.lamp_nearness
    panels, at = HighlightPanels(graded=10, even=even, order=8), jnp.zeros(1)
    x = highlight_x(sample, disc.angle, nearness)

    def one(point: tuple[jax.Array, ...]) -> jax.Array:
        angle, azimuth, distance, share = point
        near = None if nearness is None else nearness / distance
        scene = Scene(material, sample, angle, near, Turn(jnp.cos(azimuth), jnp.sin(azimuth)))
        records = (
            record_around_turned(scene, blur, x[None], at, reach, panels)[0, 0, 0]
            for blur, reach in zip(blurs, reaches, strict=True)
        )
        return share * sum(records, jnp.zeros(()))

    recorded = jnp.sum(jax.lax.map(one, tuple(jnp.asarray(a) for a in disc[1:])))
    element, _ = sample.at(x, jnp.zeros(()))
    return recorded / Scene(material, sample, jnp.asarray(disc.angle), nearness).sent(element)[0]


@kept_program
def _responses(
    material: Microfacet,
    imaging: Imaging,
    blurs: tuple[BlurTerms, ...],
    reaches: jax.Array,
    theta: jax.Array,
    even: int,
) -> jax.Array:
    panels = HighlightPanels(graded=10, even=even, order=8)

    def one(angle: jax.Array) -> jax.Array:
        sample, near = imaging.sample, imaging.lamp_nearness
        scene = Scene(material, sample, sample.lamp_angle(angle, near), near)
        x = highlight_x(sample, scene.lamp_angle, near)
        element, _ = sample.at(x, jnp.zeros(()))
        centre = jnp.zeros(1)
        recorded = sum(
            record_around(scene, blur, x[None], centre, reach, panels)[0, 0, 0]
            for blur, reach in zip(blurs, reaches, strict=True)
        )
        return recorded / scene.sent(element)[0]

    return jax.lax.map(one, theta)
