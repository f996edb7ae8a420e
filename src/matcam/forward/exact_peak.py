"""The loss at the specular peak of a real sphere or cylinder: curved, with a limb (MODEL 3, 4)."""

from __future__ import annotations

import equinox as eqx

from matcam._jax import jax, jnp
from matcam.errors import ArgumentError
from matcam.forward.blur import Blur, blur_of
from matcam.forward.highlight import Detail, record_around
from matcam.forward.kernel_scale import groups_of
from matcam.forward.scene import Scene
from matcam.material.masking import Masking
from matcam.material.microfacet import Microfacet
from matcam.material.ndf import SlopeDistribution
from matcam.rigs import Rig
from matcam.sample.flat import Flat
from matcam.sample.shape import Curved

_DETAIL = Detail(graded=10, even=6, order=8)


def exact_peak(rig: Rig, ndf: SlopeDistribution, theta: jax.Array, masking: Masking) -> jax.Array:
    """Recorded peak / true peak, theta of shape (n,). May exceed 1 close to the limb, where the BRDF bends upwards, and falls
    once the kernel reaches over it. Relative error below 1e-6 for Gaussian lenses (tests); others are sums of them."""
    if isinstance(rig.sample, Flat):
        return jnp.ones_like(theta)
    if not isinstance(rig.sample, Curved):
        raise ArgumentError(f"no exact peak is known for a {type(rig.sample).__name__}")
    blur = blur_of(rig)
    material = Microfacet(ndf, 1.0, masking=masking)
    groups = groups_of(blur, rig.sample)
    # lengths as arrays: what is compiled for one rig serves all of its kind
    reaches = jnp.asarray([group.scale.reach for group in groups])
    return _responses(material, rig.sample, blur, tuple(group.terms for group in groups), reaches, theta)


@eqx.filter_jit
def _responses(
    material: Microfacet,
    sample: Curved,
    blur: Blur,
    terms: tuple[tuple[int, ...], ...],
    reaches: jax.Array,
    theta: jax.Array,
) -> jax.Array:
    def one(angle: jax.Array) -> jax.Array:
        scene = Scene(material, sample, sample.lamp_angle(angle))
        x = sample.surface(sample.highlight(scene.lamp_angle), jnp.zeros(())).x
        element, _ = sample.at(x, jnp.zeros(()))
        centre = jnp.zeros(1)
        recorded = sum(
            record_around(scene, blur, together, x[None], centre, reaches[i], _DETAIL)[0, 0, 0]
            for i, together in enumerate(terms)
        )
        return recorded / scene.sent(element)[0]

    return jax.lax.map(one, theta)
