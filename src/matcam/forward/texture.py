"""Texture of a flat sample: its image, and its contrast after tilt and blur (Holzschuch and Pacanowski 2017, (4)).

A texture is periodic, so its image is a sum of waves. The tilt along x changes the frequency of each wave on the
sensor. The wave is multiplied by the transfer function of the camera at this frequency. The sum is evaluated at the
centres of pixels, without resampling.
"""

from __future__ import annotations

from typing import Literal, NamedTuple, get_args

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike

from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.jax import is_concrete, jax, jnp
from matcam.rigs import Rig
from matcam.sample.shape import Flat

Texels = Literal["band-limited", "squares"]
_MOST_WAVES = 1 << 25  # largest number of waves, which take half a GB per channel


def texture_contrast(rig: Rig, frequency: ArrayLike, theta_o: ArrayLike) -> jax.Array:
    """Compute the ratio of recorded to true contrast of a sinusoidal texture.

    The texture varies along the tilt. On the sensor its frequency nu becomes nu / cos(theta_o), and the ratio is the MTF
    of the camera at this frequency. A negative contrast means that bright and dark are exchanged.

    Args:
        rig: a rig with a `Flat` sample.
        frequency: frequency as seen head-on, cycles/px, any shape.
        theta_o: viewing angle, in [0, pi/2), rad; broadcasts with the frequency.

    Returns:
        Relative contrast, signed, of the broadcast shape, no unit.

    Raises:
        ArgumentError: the sample is not flat, the lens has several colours or varies over the field, or an argument is out
            of its range.

    Source:
        Holzschuch and Pacanowski (2017), equation (4); docs/model.md 3.

    Example:
        >>> rig = matcam.Rig(matcam.Camera(matcam.GaussianOptics(0.5)), matcam.Flat())
        >>> print(np.round(matcam.forward.texture_contrast(rig, 0.2, np.radians([0, 60])), 3))
        [0.768 0.344]
    """
    sample = _flat_sample(rig)
    return rig.camera.mtf(sample.frequency_on_sensor(frequency, theta_o))


def textured_picture(
    texture: ArrayLike,
    rig: Rig,
    theta_o: ArrayLike,
    shape: tuple[int, int] | None = None,
    texture_pitch: float = 1.0,
    texels: Texels = "band-limited",
) -> jax.Array:
    """Simulate the image of a textured flat sample, tilted along x.

    The camera is distant. The texture is periodic, and its centre is at the centre of the image. The result is exact to
    rounding if the MTF of the lens vanishes above the frequency `band()` of the lens, or if the texels are band-limited.

    Args:
        texture: albedo, or any other factor of the radiance, (H, W) or (H, W, channels), finite and >= 0; row 0 on top.
        rig: a rig with a `Flat` sample.
        theta_o: angle of the tilt, in [0, pi/2), rad.
        shape: (rows, columns) of the image, px. Default: None, the number of rows and columns of the texture.
        texture_pitch: distance of neighbouring texels on the sensor, head-on, px. Default: 1.
        texels: signal between the centres of the texels. Default: "band-limited", the band-limited periodic signal through
            the values. It reproduces a sampled sine exactly; at edges it overshoots, possibly below 0. With "squares" each
            texel is a square of constant albedo, as in a printed chart, and the image through a positive kernel is >= 0.

    Returns:
        Image in the texture's unit, (rows, columns) or (rows, columns, channels). A uniform texture keeps its value.
        The image is differentiable in the texture, the angle and the parameters of the camera.

    Raises:
        ArgumentError: the sample is not flat, the lens has several colours or varies over the field, an argument is out of
            its range, or the texture requires too many waves.

    Source:
        Holzschuch and Pacanowski (2017), equations (3) and (4); docs/model.md 3.

    Example:
        >>> rig = matcam.Rig(matcam.Camera(matcam.GaussianOptics(0.5)), matcam.Flat())
        >>> stripes = np.tile([0.0, 0.0, 1.0, 1.0], (4, 2))
        >>> image = matcam.forward.textured_picture(stripes, rig, theta_o=0.5, texels="squares")
        >>> image.shape, round(float(image.mean()), 2)
        ((4, 8), 0.5)
    """
    flat = _flat_sample(rig)
    checks.choice("texels", texels, get_args(Texels))
    texture = _check_texture(texture)
    theta_o = checks.scalar("theta_o", checks.viewing_angle("theta_o", theta_o))
    checks.scalar("texture_pitch", checks.positive("texture_pitch", texture_pitch, "px"))
    pitch = float(texture_pitch)  # must be concrete, because it determines the number of waves
    rows, columns = _check_shape(texture.shape[:2] if shape is None else shape)
    height, width = texture.shape[:2]
    band = rig.camera.optics.band() if texels == "squares" else None
    across = _axis_waves(height, rows, 1.0, pitch, band)
    along = _axis_waves(width, columns, jnp.cos(theta_o), pitch, band)
    if along.k.size * across.k.size > _MOST_WAVES:
        raise ArgumentError(
            f"texture of {height} x {width} texels of {pitch:g} px requires {across.k.size} x {along.k.size} waves, more than "
            f"{_MOST_WAVES} in total: give a smaller texture"
        )
    frequency_x = flat.frequency_on_sensor(along.k / (width * pitch), theta_o)
    frequency_y = jnp.asarray(-across.k[:, None] / (height * pitch))  # rows are numbered downwards
    picture = _sum_of_waves(
        texture if texture.ndim == 3 else texture[..., None],
        rig.camera.transfer(frequency_x, frequency_y),
        across,
        along,
    )
    return picture if texture.ndim == 3 else picture[..., 0]


class _AxisWaves(NamedTuple):
    """Waves exp(2 pi i k u / texels) along one axis of a texture, where u is the position in texels.

    Attributes:
        texels: number of texels.
        k: wave numbers, symmetric about 0.
        weight: factor of each wave in the signal between the centres of the texels, no unit.
        at: positions of the pixels on the texture, in texels.
    """

    texels: int
    k: np.ndarray
    weight: np.ndarray
    at: jax.Array


def _axis_waves(texels: int, pixels: int, foreshortening: ArrayLike, pitch: float, band: float | None) -> _AxisWaves:
    """Build the waves along an axis.

    band: highest frequency for square texels, cycles/px; None: a band-limited signal.
    """
    at = (texels - 1) / 2 + (jnp.arange(pixels) - (pixels - 1) / 2) / (pitch * foreshortening)
    if band is None:
        k = np.arange(-(texels // 2), texels // 2 + 1)
        # at half the sampling frequency, k and -k are the same wave
        return _AxisWaves(texels, k, np.where(2 * np.abs(k) == texels, 0.5, 1.0), at)
    reach = int(np.ceil(band * texels * pitch))
    k = np.arange(-reach, reach + 1)
    return _AxisWaves(texels, k, np.sinc(k / texels), at)


@eqx.filter_jit
def _sum_of_waves(planes: jax.Array, transfer: jax.Array, across: _AxisWaves, along: _AxisWaves) -> jax.Array:
    """Sum the waves of a texture, multiplied by the transfer function of the camera; (rows, columns, channels).

    planes: texture, (H, W, channels). transfer: transfer function at the wave numbers of both axes.
    """
    spectrum = jnp.fft.fft2(planes, axes=(0, 1), norm="forward")
    spectrum = spectrum[(across.k % across.texels)[:, None], along.k % along.texels]
    spectrum = spectrum * (transfer * across.weight[:, None] * along.weight)[..., None]
    return jnp.einsum("rc,cwk->rwk", _waves(across), jnp.einsum("cdk,wd->cwk", spectrum, _waves(along))).real


def _waves(axis: _AxisWaves) -> jax.Array:
    turns = axis.at[:, None] / axis.texels * axis.k
    return jnp.exp(2j * jnp.pi * (turns - jnp.round(turns)))


def _check_texture(texture: ArrayLike) -> jax.Array:
    array = texture if not is_concrete(texture) else checks.within("texture", texture, 0, np.inf, open_high=True)
    array = jnp.asarray(array, dtype=jnp.float64)
    if array.ndim not in (2, 3):
        raise ArgumentError(f"texture must have shape (H, W) or (H, W, channels), got {array.shape}")
    if 0 in array.shape:
        raise ArgumentError(f"texture must have at least one row, column and channel, got the shape {array.shape}")
    return array


def _check_shape(shape: tuple[int, ...]) -> tuple[int, int]:
    whole = isinstance(shape, tuple) and all(isinstance(n, int | np.integer) and 1 <= n <= 1 << 15 for n in shape)
    if not whole or len(shape) != 2:
        raise ArgumentError(
            f"shape must be a tuple of two whole numbers (rows, columns) in [1, {1 << 15}], got {shape!r:.60}"
        )
    return int(shape[0]), int(shape[1])


def _flat_sample(rig: Rig) -> Flat:
    checks.instance("rig", rig, Rig)
    if not isinstance(rig.sample, Flat):
        raise ArgumentError(f"a texture needs a rig with a Flat sample, got {type(rig.sample).__name__}")
    return rig.sample
