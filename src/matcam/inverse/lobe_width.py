"""How wide a lobe is to the eye, whatever its family's numbers are."""

from __future__ import annotations

import numpy as np

from matcam._jax import jax, jnp
from matcam.inverse import fit_parameters as parameters


def half_width_of(family: str, logs: np.ndarray, covariance: np.ndarray) -> tuple[float, float]:
    """Half width at half maximum of D, rad, and its standard deviation, by bisection and by its implicit derivative."""

    def ratio(log_angle: jax.Array, q: jax.Array) -> jax.Array:
        ndf = parameters.ndf_at(family, q)
        return jnp.log(2 * ndf.d(jnp.exp(log_angle)) / ndf.d(1e-9))

    q, f = jnp.asarray(logs), jax.jit(ratio)
    low, high = np.log(1e-9), np.log(1.5)
    if float(f(high, q)) > 0:
        return float("nan"), float("nan")
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if float(f(middle, q)) > 0 else (low, middle)
    slope = jax.grad(ratio, argnums=(0, 1))(jnp.asarray(low), q)
    by_q = -np.asarray(slope[1]) / float(slope[0])
    angle = float(np.exp(low))
    return angle, angle * float(np.sqrt(by_q @ covariance @ by_q))
