"""Pixels that do not belong to an edge: hot and dead ones, dust, dirt.

Pixels that see the edge in one phase, in one aligned column, should read alike. One that lies far from the others of its
group, by their own scatter and by the noise, is left out. That needs no model of the edge.
"""

from __future__ import annotations

from matcam.calibration.edge.geometry import AlignedRows, phased_rows
from matcam.calibration.edge.maximum_likelihood import Noise
from matcam.calibration.edge.start import side_levels
from matcam.core.jax import jax, jnp

_FAR = 6.0  # standard deviations: once in 5e8 pixels
_ROUNDS = 2
_OTHERS = 3  # least number of pixels that one is compared with


def without_outliers(aligned: AlignedRows, curve: jax.Array, noise: Noise) -> AlignedRows:
    """Return rows whose outlying pixels count as missing."""
    phased = phased_rows(aligned, curve)
    member, columns = phased.member, aligned.value.shape[1]
    dark, bright = side_levels(aligned)
    level = (dark + bright) / 2
    level = jnp.where(level > 0, level / jnp.maximum(level.mean(), 1e-300), 1.0)[:, None]
    value = aligned.value / level
    variance = noise.variance(aligned.value, 1 / aligned.light[:, None]) / level**2

    def again(_: int, valid: jax.Array) -> jax.Array:
        def summed(*quantities: jax.Array) -> tuple[jax.Array, ...]:
            sums = member @ jnp.concatenate([valid * q for q in quantities], 1)
            return tuple(sums[:, i * columns : (i + 1) * columns] for i in range(len(quantities)))

        count, total, apart = summed(jnp.ones_like(value), value, phased.distance)
        some = jnp.maximum(count, 1.0)
        mean = total / some
        # within a group the distances differ by an eighth of a px
        ends = (count[:, 2:] > 0) & (count[:, :-2] > 0)
        slope = jnp.pad(jnp.where(ends, (mean[:, 2:] - mean[:, :-2]) / (2 * aligned.step), 0.0), ((0, 0), (1, 1)))
        of = lambda a: a[phased.phase]  # noqa: E731
        off = value - of(mean) - of(slope) * (phased.distance - of(apart / some))
        first, second = summed(off, off**2)
        others = jnp.maximum(of(count) - 1, 1.0)
        middle = (of(first) - off) / others
        scatter = jnp.maximum((of(second) - off**2) / others - middle**2, variance)
        far = (off - middle) ** 2 > _FAR**2 * scatter * (1 + 1 / others)
        return valid * ~(far & (of(count) > _OTHERS))

    valid = jax.lax.fori_loop(0, _ROUNDS, again, aligned.valid)
    return aligned._replace(valid=valid, value=aligned.value * valid)
