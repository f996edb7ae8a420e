"""Transfer function of a lens for images that are symmetric above and below: only the upper half is transformed.

The transform of half an image with its mirror image below is a cosine transform. Apart from a phase this is the
transform of the half with its even rows first, followed by its odd rows in reverse order (Makhoul 1980, A fast cosine
transform in one and two dimensions). The phases of both transforms are included in the transfer function, which mixes
every frequency of the half with its mirror image.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.jax import jax, jnp


class MirroredTransfer(NamedTuple):
    """Transfer of a lens for half an image.

    Attributes:
        own: factor of each frequency, (rows, columns of half the plane), no unit.
        other: factor of the frequency mirrored along the columns, same shape, complex.
    """

    own: jax.Array
    other: jax.Array

    @classmethod
    def of(cls, transfer: jax.Array) -> MirroredTransfer:
        """Build the transfer of a symmetric lens.

        transfer: transfer function of the lens at frequencies 0, 1, 2... cycles per two halves along y, an even number
            of rows.
        """
        rows = transfer.shape[0]
        mirrored = jnp.concatenate([jnp.zeros_like(transfer[:1]), transfer[:0:-1]])
        phase = np.exp(1j * np.pi * np.arange(rows) / rows)[:, None]
        return cls((transfer + mirrored) / 2, (transfer - mirrored) * phase / 2)

    def seen(self, light: jax.Array, width: int) -> jax.Array:
        """Filter an upper half by the lens, from half a step above the axis: (rows, columns, channels).

        Args:
            light: light of the half, (rows, columns, channels), 1/sr.
            width: number of columns of the periodic image.
        """
        rows = self.own.shape[0]
        order = np.concatenate([np.arange(0, rows, 2), np.arange(rows - 1, 0, -2)])
        padded = jnp.pad(light, ((0, rows - light.shape[0]), (0, width - light.shape[1]), (0, 0)))
        spectrum = jnp.fft.rfft2(padded[order], axes=(0, 1))
        mirrored = spectrum[-np.arange(rows) % rows]
        passed = self.own[..., None] * spectrum + self.other[..., None] * mirrored
        return jnp.fft.irfft2(passed, (rows, width), axes=(0, 1))[np.argsort(order)]
