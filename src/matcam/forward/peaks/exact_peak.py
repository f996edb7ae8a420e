"""Response at the peak on a curved sample with its limb: recorded peak over true peak (docs/model.md 3)."""

from __future__ import annotations

import numpy as np

from matcam.core.errors import ArgumentError
from matcam.core.jax import AnyArray, is_concrete, jax, jnp
from matcam.forward.integral.blur import imaging_of
from matcam.forward.integral.scene import Scene, highlight_x
from matcam.forward.sampler.plan import RecordPositions
from matcam.forward.sampler.under_lamp import record_under_lamp
from matcam.material.masking import Masking
from matcam.material.microfacet import Microfacet
from matcam.material.ndf.distribution import SlopeDistribution
from matcam.rigs import Rig
from matcam.sample.shape import Curved, Flat


def exact_response(rig: Rig, ndf: SlopeDistribution, theta: AnyArray, masking: Masking) -> jax.Array:
    """Compute the recorded peak divided by the true peak on the curved sample, shape (n,).

    theta: viewing angles of the highlight, shape (n,), rad. An ArgumentError is raised if they are traced.
    """
    if isinstance(rig.sample, Flat):
        return jnp.ones_like(jnp.asarray(theta))
    if not isinstance(rig.sample, Curved):
        raise ArgumentError(
            f"an exact peak needs a Sphere, a Cylinder or a Flat sample, got a {type(rig.sample).__name__}"
        )
    if not is_concrete(theta):
        raise ArgumentError(
            "the integration nodes of the exact response depend on theta, which must have concrete values: call this "
            "function outside jax.jit and jax.vmap, and do not differentiate it with respect to theta"
        )
    sample, near, material = rig.sample, rig.lamp.nearness, Microfacet(ndf, 1.0, masking=masking)
    lamps = np.asarray(jax.lax.stop_gradient(sample.lamp_angle(jnp.asarray(theta), near)))
    x = np.asarray(jax.lax.stop_gradient(highlight_x(sample, jnp.asarray(lamps), near)))
    turn = float(rig.azimuths())
    positions = RecordPositions(x * np.cos(turn), x * np.sin(turn), lamps, np.full_like(x, turn) if turn else None)
    recorded = record_under_lamp(material, rig, imaging_of(rig), positions)
    element, _ = sample.at(jnp.asarray(x), jnp.zeros(x.size))
    return recorded[:, 0] / Scene(material, sample, jnp.asarray(lamps), near).sent(element)[:, 0]
