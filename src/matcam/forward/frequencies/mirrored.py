"""A lens's transfer function for pictures that are alike above and below: only the upper half is transformed.

Half a picture with its mirror image below has a cosine transform. That is the transform of the half itself, its even rows first
and its odd ones backwards after them, but for a phase (Makhoul 1980, A fast cosine transform in one and two dimensions). There
and back, both phases join the transfer function: every frequency of the half is passed on, with a part of its mirror image.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.jax import jax, jnp


class MirroredTransfer(NamedTuple):
    """Hold what a lens lets pass of half a picture.

    Attributes:
        own: share of each frequency that stays, (rows, columns of half the plane), no unit.
        other: share of the frequency mirrored in the row that takes its place, of that shape, complex.
    """

    own: jax.Array
    other: jax.Array

    @classmethod
    def of(cls, transfer: jax.Array) -> MirroredTransfer:
        """Return it for a lens that is alike above and below.

        transfer: of the lens at frequencies 0, 1, 2... cycles per two halves along y, an even number of rows.
        """
        rows = transfer.shape[0]
        mirrored = jnp.concatenate([jnp.zeros_like(transfer[:1]), transfer[:0:-1]])
        phase = np.exp(1j * np.pi * np.arange(rows) / rows)[:, None]
        return cls((transfer + mirrored) / 2, (transfer - mirrored) * phase / 2)

    def seen(self, light: jax.Array, width: int) -> jax.Array:
        """Return what the lens shows of an upper half, from half a step above the axis: (rows, columns, channels).

        Args:
            light: of the half, (rows, columns, channels), 1/sr.
            width: columns of the periodic picture.
        """
        rows = self.own.shape[0]
        order = np.concatenate([np.arange(0, rows, 2), np.arange(rows - 1, 0, -2)])
        padded = jnp.pad(light, ((0, rows - light.shape[0]), (0, width - light.shape[1]), (0, 0)))
        spectrum = jnp.fft.rfft2(padded[order], axes=(0, 1))
        mirrored = spectrum[-np.arange(rows) % rows]
        passed = self.own[..., None] * spectrum + self.other[..., None] * mirrored
        return jnp.fft.irfft2(passed, (rows, width), axes=(0, 1))[np.argsort(order)]
