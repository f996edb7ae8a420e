"""Filter for images that are symmetric about the x axis. Only the upper half is transformed.

The Fourier transform of a symmetric image is a cosine transform of its upper half. Apart from a phase, the cosine
transform is the Fourier transform of the upper half after its rows are reordered: the even rows first, followed by the
odd rows in reverse order (Makhoul 1980, A fast cosine transform in one and two dimensions). The transfer function
includes the phases of both transforms. Each frequency of the filtered half therefore combines the same frequency of the
original half with the mirrored frequency.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.jax import jax, jnp


class MirroredTransfer(NamedTuple):
    """Transfer function of a symmetric lens for the upper half of an image.

    Attributes:
        own: factor of each frequency, (rows, columns / 2 + 1), no unit.
        other: factor of each frequency mirrored along the columns, complex, (rows, columns / 2 + 1), no unit.
    """

    own: jax.Array
    other: jax.Array

    @classmethod
    def of(cls, transfer: jax.Array) -> MirroredTransfer:
        """Build the transfer function for the upper half from the transfer function of a symmetric lens.

        `transfer` is the transfer function of the lens at the frequencies 0, 1, 2, ... cycles per height of the whole
        image. It has an even number of rows.
        """
        rows = transfer.shape[0]
        mirrored = jnp.concatenate([jnp.zeros_like(transfer[:1]), transfer[:0:-1]])
        phase = np.exp(1j * np.pi * np.arange(rows) / rows)[:, None]
        return cls((transfer + mirrored) / 2, (transfer - mirrored) * phase / 2)

    def seen(self, light: jax.Array, width: int) -> jax.Array:
        """Filter the upper half of an image by the lens, 1/sr, (rows, columns, channels).

        Args:
            light: radiance of the upper half, (rows, columns, channels), 1/sr. The first row is half a step above
                the x axis.
            width: number of columns of the periodic image.
        """
        rows = self.own.shape[0]
        order = np.concatenate([np.arange(0, rows, 2), np.arange(rows - 1, 0, -2)])
        padded = jnp.pad(light, ((0, rows - light.shape[0]), (0, width - light.shape[1]), (0, 0)))
        spectrum = jnp.fft.rfft2(padded[order], axes=(0, 1))
        mirrored = spectrum[-np.arange(rows) % rows]
        passed = self.own[..., None] * spectrum + self.other[..., None] * mirrored
        return jnp.fft.irfft2(passed, (rows, width), axes=(0, 1))[np.argsort(order)]
