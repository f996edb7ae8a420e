"""Noise of a pixel, as a reflectance measurement states it.

The sensor behind the lens: from radiance in the pixels to the numbers in a raw file (EMVA Standard 1288, release 4).

    radiance --exposure--> expected electrons --fixed-pattern gain--> + dark electrons --Poisson--> --full well-->
    + read noise --gain, black level--> --rounding, range--> DN

Fixed-pattern gain comes before the photons are counted: a more sensitive pixel counts more of them, noise included.
The well fills before it is read, so read noise sits on top of saturated pixels too.

Exposure bracketing: several pictures of one scene, merged into the radiance that they all saw, with its uncertainty.

Every picture's weight is the inverse variance that the sensor's law gives it at the merged radiance (MODEL 8), never
that of its own noisy pixels. Close to saturation a picture's weight is faded out: a sharp limit would let pixels in by
their own noise, and bias what is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike

from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.jax import AnyArray, is_concrete, jax, jnp


class PixelNoise(NamedTuple):
    """Standard deviation of a pixel: relative * its value, and floor * the brightest value of its picture, in quadrature.
    gain: relative standard deviation of a picture's exposure, common to all its pixels.

    Noise belongs to pixels: table cells that were read from one pixel share it.
    """

    relative: float = 0.01
    floor: float = 1e-4
    gain: float = 0.0

    def checked(self) -> PixelNoise:
        """Itself; ArgumentError if a number is negative, not finite, or both are 0."""
        for name, value in self._asdict().items():
            if not 0 <= value < 1:
                raise ArgumentError(f"noise.{name} must lie in [0, 1), got {value!r}")
        if self.relative == self.floor == 0:
            raise ArgumentError("noise must not be zero altogether: no measurement is")
        return self


CFAS = ("RGGB", "BGGR", "GRBG", "GBRG")
"""Bayer mosaics: the colours of the upper left 2 x 2 pixels, row by row."""

_CHANNELS = "RGB"
_DEEPEST = 32  # bits

Seed = int | jax.Array
"""A number, or a key of jax.random."""


class Sensor(eqx.Module):
    """Noise and mosaic of a camera.

    pitch: distance of its pixels, m. full_well: electrons that a pixel holds. read_noise: standard deviation, e-.
    gain: DN per e-. bits: of its converter, 1 to 32; None: neither rounded nor limited. cfa: "RGGB", "BGGR", "GRBG",
    "GBRG", or None for a sensor without colours.

    prnu: photo-response non-uniformity, relative standard deviation of the pixels' sensitivity. dark_current: e-/s.
    dark_nonuniformity: relative standard deviation of the pixels' dark currents. Both patterns are log-normal: their
    mean is 1 exactly, and no pixel is negative. black_level: DN of an empty pixel; None: as many whole DN as keep six
    standard deviations of read noise above 0. pattern_seed: which individual sensor this is; pictures of one shape
    share its patterns.
    """

    pitch: jax.Array
    full_well: jax.Array
    read_noise: jax.Array
    gain: jax.Array
    bits: int | None = eqx.field(static=True)
    cfa: str | None = eqx.field(static=True)
    prnu: jax.Array
    dark_current: jax.Array
    dark_nonuniformity: jax.Array
    black_level: jax.Array
    pattern_seed: int = eqx.field(static=True)

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
        pattern_seed: int = 0,
    ):
        def number(name: str, value: ArrayLike, low: float, high: float, unit: str = "", open_low: bool = False):  # type: ignore[no-untyped-def]
            return checks.scalar(name, checks.within(name, value, low, high, unit, open_low=open_low))

        if bits is not None and (type(bits) is not int or not 1 <= bits <= _DEEPEST):
            raise ArgumentError(f"bits must be a whole number in [1, {_DEEPEST}] or None, got {bits!r}")
        if type(pattern_seed) is not int or not 0 <= pattern_seed < 2**31:
            raise ArgumentError(f"pattern_seed must be a whole number in [0, 2^31), got {pattern_seed!r}")
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
            black_level = jnp.ceil(6 * self.read_noise * self.gain)
        self.black_level = number("black_level", black_level, 0, 2.0**_DEEPEST, "DN")
        self.pattern_seed = pattern_seed
        if bits is not None and is_concrete(self.black_level) and float(self.black_level) >= 2**bits - 1:
            raise ArgumentError(f"black_level must lie below {2**bits - 1} DN ({bits} bits), got {self.black_level:g}")

    @property
    def saturation(self) -> jax.Array:
        """Electrons at which a pixel stops to count: the well's, or the converter's where that comes first."""
        if self.bits is None:
            return self.full_well
        return jnp.minimum(self.full_well, (2**self.bits - 1 - self.black_level) / self.gain)

    def channel_map(self, height: int, width: int) -> np.ndarray:
        """Which channel (0, 1, 2 for R, G, B) each pixel of a mosaic sees, shape (height, width). ArgumentError without
        a cfa."""
        if self.cfa is None:
            raise ArgumentError("this sensor has no mosaic: its cfa is None")
        tile = np.array([_CHANNELS.index(c) for c in self.cfa]).reshape(2, 2)
        return np.tile(tile, ((height + 1) // 2, (width + 1) // 2))[:height, :width]

    def expected_electrons(self, radiance: ArrayLike, exposure: ArrayLike, time: ArrayLike = 0.0) -> jax.Array:
        """Mean electrons of every pixel of this sensor, its patterns and dark current included, before its well is full.

        radiance: of the pixels, any unit, shape (H, W) or (H, W, channels); with a cfa (H, W, 3), R, G, B, of which
        each pixel of the (H, W) result keeps one. Channels without a cfa are exposures of one sensor behind filters,
        so they share its patterns. NaN stays NaN. exposure: e- per unit of radiance, positive. time: s, for the dark
        current.
        """
        radiance = self._mosaic(_checked_radiance(radiance))
        exposure, time = _checked_exposure(exposure, time)
        sensitivity, dark = self._patterns(radiance.shape[:2])
        if radiance.ndim == 3:
            sensitivity, dark = sensitivity[..., None], dark[..., None]
        return exposure * sensitivity * radiance + time * self.dark_current * dark

    def expose(self, radiance: ArrayLike, exposure: ArrayLike, seed: Seed, time: ArrayLike = 0.0) -> jax.Array:
        """One picture, DN: arguments and shape as `expected_electrons`. seed: of the picture's own noise."""
        shot, read = jax.random.split(random_key(seed))
        expected = self.expected_electrons(radiance, exposure, time)
        missing = jnp.isnan(expected)
        # counts far beyond the well are all alike, and the generator's integers end at 2^31
        countable = jnp.where(missing, 0.0, jnp.minimum(expected, 2 * self.full_well + 100))
        charge = jnp.minimum(jax.random.poisson(shot, countable).astype(jnp.float64), self.full_well)
        charge += self.read_noise * jax.random.normal(read, charge.shape)
        digital = self.gain * charge + self.black_level
        if self.bits is not None:
            digital = jnp.clip(jnp.round(digital), 0, 2**self.bits - 1)
        return jnp.where(missing, jnp.nan, digital)

    def electrons(self, digital: ArrayLike) -> jax.Array:
        """Electrons that a picture in DN speaks of; negative where read noise was."""
        return (jnp.asarray(digital, dtype=jnp.float64) - self.black_level) / self.gain

    def variance(self, electrons: ArrayLike) -> jax.Array:
        """Variance, e-^2, of a pixel that expects so many `electrons`, dark ones included: shot, read and rounding.
        A law of the sensor: to be evaluated at a model's value, not at the noisy pixel's own (MODEL 8)."""
        rounding = 0.0 if self.bits is None else 1 / (12 * self.gain**2)
        return jnp.maximum(jnp.asarray(electrons, dtype=jnp.float64), 0) + self.read_noise**2 + rounding

    def _mosaic(self, radiance: jax.Array) -> jax.Array:
        if self.cfa is None:
            return radiance
        if radiance.shape[2:] != (3,):
            raise ArgumentError(f"radiance for a {self.cfa} sensor must have shape (H, W, 3), got {radiance.shape}")
        channel = jnp.asarray(self.channel_map(*radiance.shape[:2]))
        return jnp.take_along_axis(radiance, channel[..., None], axis=2)[..., 0]

    def _patterns(self, shape: tuple[int, ...]) -> tuple[jax.Array, jax.Array]:
        gain, dark = jax.random.split(jax.random.key(self.pattern_seed))
        return _log_normal(gain, shape, self.prnu), _log_normal(dark, shape, self.dark_nonuniformity)

    def __repr__(self) -> str:
        return (
            f"Sensor(pitch={self.pitch!s}, full_well={self.full_well!s}, read_noise={self.read_noise!s}, "
            f"gain={self.gain!s}, bits={self.bits!r}, cfa={self.cfa!r}, prnu={self.prnu!s}, "
            f"dark_current={self.dark_current!s}, dark_nonuniformity={self.dark_nonuniformity!s}, "
            f"black_level={self.black_level!s}, pattern_seed={self.pattern_seed!r})"
        )


def _log_normal(key: jax.Array, shape: tuple[int, ...], std: jax.Array) -> jax.Array:
    """Positive numbers of mean 1 and standard deviation `std`."""
    log_variance = jnp.log1p(std**2)
    log_std = jnp.where(std > 0, jnp.sqrt(jnp.where(std > 0, log_variance, 1.0)), 0.0)
    return jnp.exp(log_std * jax.random.normal(key, shape) - log_variance / 2)


def _checked_radiance(radiance: ArrayLike) -> jax.Array:
    array = jnp.asarray(radiance, dtype=jnp.float64)
    if array.ndim not in (2, 3) or 0 in array.shape:
        raise ArgumentError(f"radiance must have shape (H, W) or (H, W, channels), got {array.shape}")
    if not is_concrete(array):
        return array
    largest, smallest = (float(f(array, where=~jnp.isnan(array), initial=0.0)) for f in (jnp.max, jnp.min))
    if not np.isfinite(largest) or smallest < -1e-9 * largest:
        raise ArgumentError(f"radiance must lie in [0, inf), got {largest if np.isinf(largest) else smallest:g}")
    return jnp.maximum(array, 0)  # what a kernel with signed terms leaves below 0 is rounding


def _checked_exposure(exposure: ArrayLike, time: ArrayLike) -> tuple[jax.Array, jax.Array]:
    exposure = checks.scalar("exposure", checks.positive("exposure", exposure, "e- per unit of radiance"))
    return exposure, checks.scalar("time", checks.within("time", time, 0, np.inf, "s", open_high=True))


def random_key(seed: Seed) -> jax.Array:
    """The key that a seed stands for."""
    if isinstance(seed, jax.Array) and jnp.issubdtype(seed.dtype, jax.dtypes.prng_key):
        return seed
    if not isinstance(seed, int | np.integer) or isinstance(seed, bool) or seed < 0:
        raise ArgumentError(f"seed must be a whole number >= 0 or a key of jax.random, got {seed!r:.60}")
    return jax.random.key(int(seed))


_FADE = (0.85, 0.95)  # of saturation: from full weight to none
_ROUNDS = 3


class Merged(NamedTuple):
    """A radiance estimate of shape (H, W) or (H, W, channels), in the unit that the exposures are per."""

    radiance: jax.Array
    """NaN where every picture is saturated, or the data are missing."""
    std: jax.Array
    """Standard deviation, fixed-pattern gain included."""
    saturated: jax.Array
    """True where every picture is."""


def expose_bracket(
    sensor: Sensor, radiance: ArrayLike, exposures: Sequence[float], seed: Seed, times: Sequence[float] | None = None
) -> jax.Array:
    """Pictures of one scene, DN, shape (pictures, H, W[, channels]): `Sensor.expose` at each of `exposures`, e- per unit
    of radiance, and `times`, s. Their noise is independent, their fixed patterns are the sensor's."""
    exposures, times = _checked(exposures, times)
    pairs = zip(jax.random.split(random_key(seed), len(exposures)), exposures, times, strict=True)
    return jnp.stack([sensor.expose(radiance, exposure, one, time) for one, exposure, time in pairs])


def merge_bracket(
    sensor: Sensor, pictures: AnyArray, exposures: Sequence[float], times: Sequence[float] | None = None
) -> Merged:
    """Radiance from pictures of one scene: DN, shape (pictures, H, W[, channels]), taken at `exposures` and `times`.

    The minimum-variance weighted mean of the pictures less their mean dark electrons. Without saturation it is unbiased
    but for the weights' faint dependence on the data.
    """
    exposures, times = _checked(exposures, times)
    pictures = jnp.asarray(pictures, dtype=jnp.float64)
    if pictures.shape[:1] != (len(exposures),) or pictures.ndim not in (3, 4):
        raise ArgumentError(
            f"pictures must have shape ({len(exposures)}, H, W) or ({len(exposures)}, H, W, channels), one per exposure, "
            f"got {pictures.shape}"
        )
    column = (-1,) + (1,) * (pictures.ndim - 1)
    exposure, time = (jnp.asarray(a, dtype=jnp.float64).reshape(column) for a in (exposures, times))
    dark = time * sensor.dark_current
    electrons = sensor.electrons(pictures)
    low, high = _FADE
    share = jnp.clip((high - electrons / sensor.saturation) / (high - low), 0, 1)
    usable = share > 0
    saturated = ~jnp.any(usable | jnp.isnan(electrons), axis=0)

    # the mean for shot noise alone needs no variance to start from
    weight = share * exposure
    radiance = jnp.sum(share * (electrons - dark), axis=0) / _nan_where_zero(jnp.sum(weight, axis=0))
    for _ in range(_ROUNDS):
        variance = _variance(sensor, radiance, exposure, dark)
        weight = share / variance
        weight = weight / _nan_where_zero(jnp.sum(weight, axis=0))
        radiance = jnp.sum(weight * (electrons - dark) / exposure, axis=0)
    # patterns are the same in all pictures: averaging does not help against them
    common = (sensor.prnu * radiance) ** 2
    common += (sensor.dark_nonuniformity * jnp.sum(weight * dark / exposure, axis=0)) ** 2
    std = jnp.sqrt(jnp.sum(weight**2 * _variance(sensor, radiance, exposure, dark), axis=0) + common)
    return Merged(radiance, std, saturated)


def _variance(sensor: Sensor, radiance: jax.Array, exposure: jax.Array, dark: jax.Array) -> jax.Array:
    return sensor.variance(exposure * jnp.maximum(radiance, 0) + dark) / exposure**2


def _nan_where_zero(total: jax.Array) -> jax.Array:
    return jnp.where(total > 0, total, jnp.nan)


def _checked(exposures: Sequence[float], times: Sequence[float] | None) -> tuple[tuple[float, ...], tuple[float, ...]]:
    positive = checks.positive("exposures", jnp.atleast_1d(jnp.asarray(exposures)), "e- per unit of radiance")
    if positive.ndim != 1 or positive.size == 0:
        raise ArgumentError(f"exposures must be a list of numbers, got shape {positive.shape}")
    exposed = tuple(positive.tolist())
    lasted = (0.0,) * len(exposed) if times is None else tuple(float(t) for t in times)
    if len(lasted) != len(exposed):
        raise ArgumentError(f"times must be as many as exposures ({len(exposed)}), got {len(lasted)}")
    checks.within("times", jnp.asarray(lasted), 0, float("inf"), "s", open_high=True)
    return exposed, lasted
