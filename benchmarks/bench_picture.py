"""A picture of 512 x 512 px (GGX on a sphere of 240 px, lamp at 60 degrees) against supersampling to the same error.

Supersampling: radiance at the centres of n x n parts of every pixel, blurred and integrated by the exact kernel at those
places, JAX, compiled, strip by strip; n is doubled until its largest error is below a thousandth of the picture's peak.
Ours is asked for the same error. Both are judged by the exact picture, whose own error tests/forward/test_image.py holds
to 1e-4 of every value. Neither time holds
compilation.
"""

import os
import statistics
import time
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from matcam import GGX, Camera, GaussianOptics, Microfacet, Rig, Sphere, picture
from matcam.forward import picture_values
from results import record

SIDE, RADIUS, SIGMA, HALF, LAMP, ASKED, ROUNDS = 512, 240.0, 0.5, 0.5, np.pi / 3, 1e-3, 3
NEIGHBOURS = 4  # pixels to either side that the kernel reaches


def kernel_table(n):
    """Weights of the n parts of each of the pixels around: shape (2 NEIGHBOURS + 1, n)."""
    offset = np.arange(-NEIGHBOURS, NEIGHBOURS + 1)[:, None] + (np.arange(n) + 0.5) / n - 0.5
    unit = np.sqrt(2) * SIGMA
    ends = (jax.lax.erf((offset + side * HALF) / unit) for side in (1.0, -1.0))
    return (next(ends) - next(ends)) / (4 * HALF) / n


@partial(jax.jit, static_argnums=1)
def supersampled(alpha, n):
    weights = kernel_table(n)
    fine = (jnp.arange(SIDE * n) + 0.5) / n - SIDE / 2

    def strip(row):
        y = SIDE / 2 - row - (jnp.arange(n) + 0.5) / n
        n_x, n_y = fine[None, :] / RADIUS, y[:, None] / RADIUS
        n_z = jnp.sqrt(jnp.maximum(1 - n_x**2 - n_y**2, 0))
        cos_i = n_x * np.sin(LAMP) + n_z * np.cos(LAMP)
        cos_h = n_x * np.sin(LAMP / 2) + n_z * np.cos(LAMP / 2)
        lit = (n_z > 0) & (cos_i > 0)
        cos_o, cos_i = jnp.where(lit, n_z, 1.0), jnp.where(lit, cos_i, 1.0)
        d = (alpha / (cos_h**2 * (alpha**2 - 1) + 1)) ** 2 / np.pi
        lambdas = sum((jnp.sqrt(1 + alpha**2 * (1 / c**2 - 1)) - 1) / 2 for c in (cos_i, cos_o))
        light = jnp.where(lit, d / (1 + lambdas) / (4 * cos_o), 0.0)
        # along the row: every pixel from the parts of its neighbours
        parts = jnp.pad(light.reshape(n, SIDE, n), ((0, 0), (NEIGHBOURS, NEIGHBOURS), (0, 0)))
        return sum(parts[:, k : k + SIDE] @ weights[k] for k in range(2 * NEIGHBOURS + 1))

    lines = jax.lax.map(strip, jnp.arange(SIDE, dtype=float))
    lines = jnp.pad(lines, ((NEIGHBOURS, NEIGHBOURS), (0, 0), (0, 0)))
    # rows run downwards, the parts' offsets with them
    return sum(jnp.einsum("rnc,n->rc", lines[k : k + SIDE], weights[k]) for k in range(2 * NEIGHBOURS + 1))


def main() -> None:
    print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    rig = Rig(Camera(GaussianOptics(SIGMA)), Sphere(RADIUS))
    rows = []
    for alpha in (0.0002, 0.001, 0.005, 0.05):

        def ours(alpha=alpha):
            return picture(Microfacet(GGX(alpha), 1.0), rig, LAMP, shape=(SIDE, SIDE), error=ASKED).values[..., 0]

        truth = np.asarray(picture_values(Microfacet(GGX(alpha), 1.0), rig, LAMP, (SIDE, SIDE)))[..., 0]
        own_error = np.abs(ours() - truth).max() / truth.max()
        n = 1
        while (error := np.abs(np.asarray(supersampled(alpha, n)) - truth).max() / truth.max()) > ASKED and n < 64:
            n *= 2
        ratios = []
        for _ in range(ROUNDS):
            start = time.perf_counter()
            ours()
            middle = time.perf_counter()
            supersampled(alpha, n).block_until_ready()
            ratios.append((time.perf_counter() - middle) / (middle - start))
        quantity = (
            f"supersampling to 1e-3 of the peak / `picture(error=1e-3)`, GGX {alpha} ({n} x {n} samples per pixel)"
        )
        rows.append((quantity, "≥ 10", f"{statistics.median(ratios):.2g}; error {own_error:.0e}"))
        print(
            f"alpha {alpha}: {n} x {n} parts of a pixel for an error of {error:.1e} of the peak; "
            f"ours, off by {own_error:.1e}: "
            f"{statistics.median(ratios):.1f} x faster than that; {min(ratios):.1f} to {max(ratios):.1f} in {ROUNDS} rounds "
            "(asked for 10)",
            flush=True,
        )
    record("bench_picture.py", rows)


if __name__ == "__main__":
    main()
