"""`measure` of a whole table (GGX 0.005 on the MERL rig) against a naive quadrature: for every cell and both ways, 16 x 16
Gauss-Legendre nodes in polar coordinates about the half vector, over the part of the sphere under the pixel's kernel.

The naive one is JAX too, compiled, in batches. Neither time holds compilation. Memory: the process's highest, without what
the naive one adds (ours runs first)."""

import os
import resource
import statistics
import time

import jax
import jax.numpy as jnp
import numpy as np

from matcam import GGX, Microfacet, rigs
from matcam.core.grid import below_horizon, merl_grid
from matcam.forward.measurement import table_values
from results import record

ALPHA, NODES, RADIUS, SIGMA, HALF, BATCH, ROUNDS = 0.005, 16, 256.0, 0.5, 0.5, 4096, 3
REACH = HALF + 5.2 * SIGMA


def kernel(offset):
    unit = np.sqrt(2) * SIGMA
    return (jax.lax.erf((offset + HALF) / unit) - jax.lax.erf((offset - HALF) / unit)) / (4 * HALF)


def naive_cell(theta_h, theta_d, phi_d):
    """One way of a cell: the pixel's window in theta_h and azimuth, clipped to the sphere, seen through the kernel."""
    psi = jnp.pi - phi_d
    half = jnp.array([jnp.sin(theta_d), 0.0, jnp.cos(theta_d)])
    x, y = _position(theta_h, psi, half)
    cos_o = jnp.maximum(jnp.cos(theta_h) * half[2] - jnp.sin(theta_h) * jnp.cos(psi) * half[0], 0.02)
    size = REACH * np.sqrt(2) / RADIUS / cos_o
    unit, weight = (jnp.asarray(a) for a in np.polynomial.legendre.leggauss(NODES))
    low, high = jnp.maximum(theta_h - size, 0), jnp.minimum(theta_h + size, jnp.pi / 2)
    theta = (low + high) / 2 + (high - low) / 2 * unit
    turn = jnp.minimum(size / jnp.maximum(jnp.sin(theta), 1e-9), jnp.pi)
    at = psi + turn[:, None] * unit
    theta_2 = theta[:, None]
    normal_x, normal_y = _position(theta_2, at, half)
    n = jnp.stack(jnp.broadcast_arrays(normal_x, normal_y)) / RADIUS
    n_z = jnp.cos(theta_2) * half[2] - jnp.sin(theta_2) * jnp.cos(at) * half[0]
    cos_i = n[0] * jnp.sin(2 * theta_d) + n_z * jnp.cos(2 * theta_d)
    d = (ALPHA / (jnp.cos(theta_2) ** 2 * (ALPHA**2 - 1) + 1)) ** 2 / np.pi
    lambdas = sum((jnp.sqrt(1 + ALPHA**2 * (1 / jnp.clip(c, 1e-9, 1) ** 2 - 1)) - 1) / 2 for c in (cos_i, n_z))
    light = jnp.where((cos_i > 0) & (n_z > 0), d / (1 + lambdas) / 4, 0.0)
    through = kernel(normal_x - x) * kernel(normal_y - y)
    share = weight[:, None] * weight * (high - low) / 2 * turn[:, None] * jnp.sin(theta_2) * RADIUS**2
    mean, side = jnp.cos(theta_h) * jnp.cos(theta_d), jnp.sin(theta_h) * jnp.sin(theta_d) * jnp.cos(phi_d)
    return jnp.sum(light * through * share) / (mean - side)


def _position(theta, psi, half):
    across = jnp.sin(theta) * jnp.cos(psi)
    return RADIUS * (jnp.cos(theta) * half[0] + across * half[2]), RADIUS * jnp.sin(theta) * jnp.sin(psi) * (
        1 + 0 * half[0]
    )


@jax.jit
def naive(theta_h, theta_d, phi_d):
    def batch(cells):
        one, other = (jax.vmap(naive_cell)(cells[0], cells[1], cells[2] + turn) for turn in (0, np.pi))
        return (one + other) / 2

    return jax.lax.map(batch, (theta_h, theta_d, phi_d))


def main() -> None:
    cells = [a[~below_horizon("centre")] for a in np.meshgrid(*merl_grid("centre"), indexing="ij")]
    count = -(-cells[0].size // BATCH) * BATCH
    cells = [np.resize(a, count).reshape(-1, BATCH) for a in cells]
    material, rig = Microfacet(GGX(ALPHA), 1.0), rigs.merl()

    def ours():
        return table_values(material, rig)[0].block_until_ready()

    ours()
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GiB (asked for 2 GB)")
    naive(*cells).block_until_ready()
    print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    times = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        ours()
        middle = time.perf_counter()
        naive(*cells).block_until_ready()
        times.append((middle - start, time.perf_counter() - middle))
    ratios = [theirs / own for own, theirs in times]
    shown = f"{statistics.median(ratios):.1f} ({min(ratios):.1f} to {max(ratios):.1f} in {ROUNDS} rounds)"
    record(
        "bench_measure.py",
        [
            ("quadrature with 256 polar nodes in every cell / `measure`, GGX 0.005, MERL rig", "≥ 10", shown),
            ("peak memory of `measure`", "< 2 GB", f"{memory:.2f} GiB"),
        ],
    )
    print(
        f"measure: {statistics.median(own for own, _ in times):.1f} s; naive: {statistics.median(t for _, t in times):.1f} s"
    )
    print(
        f"ratio {statistics.median(ratios):.1f}; {min(ratios):.1f} to {max(ratios):.1f} in {ROUNDS} rounds (asked for 10)"
    )


if __name__ == "__main__":
    main()
