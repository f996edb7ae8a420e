"""Sensor: from the radiance of pixels to the values in a raw file (EMVA Standard 1288, release 4).

    radiance --exposure--> expected electrons --fixed-pattern gain--> + dark electrons --Poisson--> --full well-->
    + read noise + offset pattern --gain, black level--> --rounding, range--> DN

Fixed-pattern gain applies before the photons are counted, so it scales shot noise accordingly. The well fills before it
is read, so saturated pixels have read noise, too.

`Sensor` simulates this chain. `PixelNoise` describes the result with the few parameters of a reflectance measurement.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from matcam.core import checks
from matcam.core.arrays import is_concrete, xp
from matcam.core.arrays.module import Module, static_field
from matcam.core.errors import ArgumentError
from matcam.core.registry import CFAS

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import jax

_DEEPEST = 32  # largest depth of a converter, bits

if TYPE_CHECKING:
    Seed = int | jax.Array
else:
    Seed = Any
"""Seed of random numbers: an integer, or a key of jax.random."""


class PixelNoise(NamedTuple):
    """Noise of a measured reflectance.

    The variance of a pixel is (relative * value)^2 + (floor * peak)^2. Here, value is the value of the pixel, and peak is
    the largest value of the image. All table cells that are read from one pixel have the noise of that pixel.

    Attributes:
        relative: standard deviation divided by the value of the pixel, no unit, [0, 1). Default: 0.01.
        floor: standard deviation divided by the largest value of the image, no unit, [0, 1). Default: 1e-4. Increase it
            if dark parts are noisier.
        picture_gain: relative standard deviation of the exposure of an image, common to all its pixels, no unit,
            [0, 1). Default: 0. Increase it if the lamp or the shutter fluctuates. (The system gain of a sensor, DN per
            electron, is `Sensor.gain`.)

    Example:
        >>> matcam.camera.PixelNoise(relative=0.02).check()
        PixelNoise(relative=0.02, floor=0.0001, picture_gain=0.0)
    """

    relative: float = 0.01
    floor: float = 1e-4
    picture_gain: float = 0.0

    def check(self) -> PixelNoise:
        """Check the parameters and return this object.

        Raises:
            ArgumentError: a parameter is outside [0, 1) or not finite, or relative and floor are both 0.
        """
        for name, value in self._asdict().items():
            checks.scalar(f"noise.{name}", checks.within(f"noise.{name}", value, 0, 1, open_high=True))
        if self.relative == self.floor == 0:
            raise ArgumentError("noise must not be zero: set noise.relative or noise.floor above 0")
        return self


class Sensor(Module):
    """Camera sensor with noise and an optional mosaic.

    The relative sensitivities and the relative dark currents of the pixels are log-normal: the distributions have a mean
    of 1, and no value is negative. The offsets of the pixels are Gaussian.

    Args:
        pitch: distance between the centres of neighbouring pixels, m.
        full_well: full-well capacity of a pixel, e-.
        read_noise: standard deviation of the read noise, e-.
        gain: system gain (EMVA 1288), DN per e-. Default: 1.
        bits: depth of the converter, 1 to 32. Default: None, values are neither rounded nor limited.
        cfa: colours of the upper left 2 x 2 pixels, "RGGB", "BGGR", "GRBG" or "GBRG". Default: None, a monochrome
            sensor.
        prnu: photo-response non-uniformity, the relative standard deviation of the sensitivity of the pixels, no unit.
            Default: 0.
        dark_current: mean dark current of a pixel, e-/s. Default: 0.
        dark_nonuniformity: relative standard deviation of the dark currents of the pixels, no unit. Default: 0.
        black_level: value of a pixel without electrons, DN. Default: None, six standard deviations of read noise, rounded
            up.
        dsnu: dark signal non-uniformity that is independent of time, the standard deviation of the offsets of the
            pixels, e-. Default: 0.
        pattern_seed: seed of the fixed patterns of the sensor, 0 to 2^31 - 1. All images of one shape have the same
            patterns. Default: 0.

    Raises:
        ArgumentError: a parameter is out of range or of the wrong kind, or the black level is not below the largest value
            of the converter.

    Source:
        EMVA Standard 1288, release 4; docs/model.md 8.

    Example:
        >>> sensor = matcam.Sensor(5e-6, full_well=10_000, read_noise=3.0, bits=12)
        >>> float(sensor.variance(500.0)), float(sensor.saturation)
        (509.083..., 4077.0)
    """

    pitch: jax.Array
    full_well: jax.Array
    read_noise: jax.Array
    gain: jax.Array
    bits: int | None = static_field()
    cfa: str | None = static_field()
    prnu: jax.Array
    dark_current: jax.Array
    dark_nonuniformity: jax.Array
    black_level: jax.Array
    dsnu: jax.Array
    pattern_seed: int = static_field()

    def __init__(
        self,
        pitch: ArrayLike,
        full_well: ArrayLike,
        read_noise: ArrayLike,
        gain: ArrayLike = 1.0,
        bits: int | None = None,
        cfa: str | None = None,
        *,
        prnu: ArrayLike = 0.0,
        dark_current: ArrayLike = 0.0,
        dark_nonuniformity: ArrayLike = 0.0,
        black_level: ArrayLike | None = None,
        dsnu: ArrayLike = 0.0,
        pattern_seed: int = 0,
    ):
        def number(name: str, value: ArrayLike, low: float, high: float, unit: str = "", open_low: bool = False):  # type: ignore[no-untyped-def]
            return checks.scalar(name, checks.within(name, value, low, high, unit, open_low=open_low))

        checks.whole_number("bits", bits, 1, _DEEPEST, optional=True)
        checks.whole_number("pattern_seed", pattern_seed, 0, 2**31 - 1)
        self.pitch = number("pitch", pitch, 1e-8, 1e-2, "m (5 um is 5e-6)")
        self.full_well = number("full_well", full_well, 1, 1e8, "e-")
        self.read_noise = number("read_noise", read_noise, 0, 1e6, "e-")
        self.gain = number("gain", gain, 0, 1e6, "DN per e-", open_low=True)
        self.bits = bits
        self.cfa = None if cfa is None else checks.choice("cfa", cfa, CFAS)
        self.prnu = number("prnu", prnu, 0, 1)
        self.dark_current = number("dark_current", dark_current, 0, 1e8, "e-/s")
        self.dark_nonuniformity = number("dark_nonuniformity", dark_nonuniformity, 0, 10)
        if black_level is None:
            black_level = xp.ceil(6 * self.read_noise * self.gain)
        self.black_level = number("black_level", black_level, 0, 2.0**_DEEPEST, "DN")
        self.dsnu = number("dsnu", dsnu, 0, 1e6, "e-")
        self.pattern_seed = pattern_seed
        if bits is not None and is_concrete(self.black_level) and float(self.black_level) >= 2**bits - 1:
            raise ArgumentError(f"black_level must lie below {2**bits - 1} DN ({bits} bits), got {self.black_level:g}")

    @property
    def saturation(self) -> jax.Array:
        """Number of electrons at which the pixels or the converter saturate, e-."""
        if self.bits is None:
            return self.full_well
        return xp.minimum(self.full_well, (2**self.bits - 1 - self.black_level) / self.gain)

    def channel_map(self, height: int, width: int) -> np.ndarray:
        """Compute the channel of each pixel of a mosaic.

        The channels 0, 1 and 2 are R, G and B.

        Args:
            height: height of the image, px.
            width: width of the image, px.

        Returns:
            Whole numbers, shape (height, width).

        Raises:
            ArgumentError: the sensor has no cfa.
        """
        if self.cfa is None:
            raise ArgumentError(
                'this sensor has no mosaic, because cfa is None: give cfa to Sensor, such as cfa="RGGB"'
            )
        tile = np.array(["RGB".index(c) for c in self.cfa]).reshape(2, 2)
        return np.tile(tile, ((height + 1) // 2, (width + 1) // 2))[:height, :width]

    def expected_electrons(self, radiance: ArrayLike, exposure: ArrayLike, time: ArrayLike = 0.0) -> jax.Array:
        """Compute the expected number of electrons of every pixel, without saturation.

        It includes the dark current and the fixed patterns of sensitivity and dark current.

        Args:
            radiance: radiance of the pixels, any unit, shape (H, W) or (H, W, channels). With a cfa the shape must be
                (H, W, 3), in the order R, G, B, and each pixel records one of these channels. Without a cfa, the channels
                are exposures of one sensor behind different filters, so they have the same fixed patterns. NaN remains
                NaN.
            exposure: electrons per unit of radiance, positive.
            time: exposure time for the dark current, s. Default: 0.

        Returns:
            Expected numbers of electrons, e-, shape (H, W) with a cfa, otherwise the shape of `radiance`.

        Raises:
            ArgumentError: an argument is out of range or has the wrong shape.
        """
        from matcam.core.jax import jax

        radiance = self._mosaic(_checked_radiance(radiance))
        exposure = checks.scalar("exposure", checks.positive("exposure", exposure, "e- per unit of radiance"))
        time = checks.scalar("time", checks.within("time", time, 0, np.inf, "s", open_high=True))
        # all channels have the same fixed patterns
        shape = radiance.shape[:2] + (1,) * (radiance.ndim - 2)
        gain_key, dark_key = jax.random.split(jax.random.key(self.pattern_seed))
        sensitivity = _log_normal(gain_key, shape, self.prnu)
        dark = _log_normal(dark_key, shape, self.dark_nonuniformity)
        return exposure * sensitivity * radiance + time * self.dark_current * dark

    def expose(self, radiance: ArrayLike, exposure: ArrayLike, seed: Seed, time: ArrayLike = 0.0) -> jax.Array:
        """Simulate one image with noise.

        Args:
            radiance: as in `expected_electrons`.
            exposure: electrons per unit of radiance, positive.
            seed: seed of the noise of the image: a whole number in [0, 2^63), or a key of jax.random.
            time: exposure time for the dark current, s. Default: 0.

        Returns:
            The image, DN, with the shape of the result of `expected_electrons`. It is NaN where the radiance is NaN.

        Raises:
            ArgumentError: an argument is out of range or has the wrong shape.
        """
        from matcam.core.jax import jax

        shot, read = jax.random.split(random_key(seed))
        expected = self.expected_electrons(radiance, exposure, time)
        missing = xp.isnan(expected)
        # counts far beyond the well are equivalent, and the integers of the generator end at 2^31
        countable = xp.where(missing, 0.0, xp.minimum(expected, 2 * self.full_well + 100))
        charge = xp.minimum(jax.random.poisson(shot, countable).astype(xp.float64), self.full_well)
        charge = charge + self.read_noise * jax.random.normal(read, charge.shape)
        # patterns 0 and 1 are those of sensitivity and dark current
        pattern = jax.random.fold_in(jax.random.key(self.pattern_seed), 2)
        charge += self.dsnu * jax.random.normal(pattern, charge.shape[:2] + (1,) * (charge.ndim - 2))
        digital = self.gain * charge + self.black_level
        if self.bits is not None:
            digital = xp.clip(xp.round(digital), 0, 2**self.bits - 1)
        return xp.where(missing, xp.nan, digital)

    def electrons(self, digital: ArrayLike) -> jax.Array:
        """Convert an image from DN to electrons, e-.

        The result can be negative because of read noise.

        Args:
            digital: the image, DN, any shape.
        """
        return (checks.numbers("digital", digital) - self.black_level) / self.gain

    def variance(self, electrons: ArrayLike) -> jax.Array:
        """Compute the variance of a pixel, e-^2.

        It includes shot noise, read noise and rounding.

        Args:
            electrons: expected number of electrons, including dark electrons, e-, any shape. Use the value of a model, not
                the noisy value of the pixel (docs/model.md 8).
        """
        rounding = 0.0 if self.bits is None else 1 / (12 * self.gain**2)
        return xp.maximum(checks.numbers("electrons", electrons), 0) + self.read_noise**2 + rounding

    def _mosaic(self, radiance: jax.Array) -> jax.Array:
        if self.cfa is None:
            return radiance
        if radiance.shape[2:] != (3,):
            raise ArgumentError(f"radiance for a {self.cfa} sensor must have shape (H, W, 3), got {radiance.shape}")
        channel = xp.asarray(self.channel_map(*radiance.shape[:2]))
        return xp.take_along_axis(radiance, channel[..., None], axis=2)[..., 0]


def _log_normal(key: jax.Array, shape: tuple[int, ...], std: jax.Array) -> jax.Array:
    """Draw values from a log-normal distribution with mean 1 and standard deviation `std`."""
    from matcam.core.jax import jax

    log_variance = xp.log1p(std**2)
    log_std = xp.where(std > 0, xp.sqrt(xp.where(std > 0, log_variance, 1.0)), 0.0)
    return xp.exp(log_std * jax.random.normal(key, shape) - log_variance / 2)


def _checked_radiance(radiance: ArrayLike) -> jax.Array:
    array = checks.numbers("radiance", radiance)
    if array.ndim not in (2, 3) or 0 in array.shape:
        raise ArgumentError(f"radiance must have shape (H, W) or (H, W, channels), got {array.shape}")
    if not is_concrete(array):
        return array
    largest, smallest = (float(f(array, where=~xp.isnan(array), initial=0.0)) for f in (xp.max, xp.min))
    if not np.isfinite(largest) or smallest < -1e-9 * largest:
        raise ArgumentError(f"radiance must lie in [0, inf), got {largest if np.isinf(largest) else smallest:g}")
    return xp.maximum(array, 0)  # negative remainders of a kernel with signed terms are rounding


def random_key(seed: Seed) -> jax.Array:
    from matcam.core.jax import jax

    if isinstance(seed, jax.Array) and jax.numpy.issubdtype(seed.dtype, jax.dtypes.prng_key):
        return seed
    # JAX takes a seed as a signed integer of 64 bits
    if not isinstance(seed, int | np.integer) or isinstance(seed, bool) or not 0 <= seed < (1 << 63):
        raise ArgumentError(f"seed must be a whole number in [0, 2^63) or a key of jax.random, got {seed!r:.60}")
    return jax.random.key(int(seed))
