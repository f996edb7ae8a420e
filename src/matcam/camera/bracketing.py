"""Exposure bracketing: several images of one scene are merged into an estimate of its radiance, with uncertainty.

The weight of an image is the inverse of its variance. The model of the sensor predicts the variance from the merged
radiance (docs/model.md 8), not from the noisy pixels of the image. Near saturation the weight decreases smoothly to 0,
because a sharp limit would select pixels by their noise and bias the result.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from jax.typing import ArrayLike

from matcam.camera.sensor import Seed, Sensor, random_key
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.jax import AnyArray, jax, jnp


class RadianceEstimate(NamedTuple):
    """Radiance estimated from a bracket of exposures.

    Attributes:
        radiance: estimate, in the unit of radiance to which the exposures refer, shape (H, W) or (H, W, channels); NaN
            where every image is saturated, or any image is NaN.
        std: standard deviation of `radiance`, including fixed patterns, same unit and shape.
        saturated: True where every image is saturated, same shape.

    Example:
        >>> pixel = matcam.camera.RadianceEstimate(np.array([[1.0]]), np.array([[0.02]]), np.array([[False]]))
        >>> float(pixel.std[0, 0])
        0.02
    """

    radiance: jax.Array
    std: jax.Array
    saturated: jax.Array


def expose_bracket(
    sensor: Sensor, radiance: ArrayLike, exposures: Sequence[float], seed: Seed, times: Sequence[float] | None = None
) -> jax.Array:
    """Simulate images of one scene at several exposures.

    The noise of the images is independent; the fixed patterns are those of the sensor.

    Args:
        sensor: sensor of the images; its noise and its fixed patterns are simulated.
        radiance: radiance of the pixels, any unit, shape (H, W) or (H, W, channels), as in `Sensor.expected_electrons`.
        exposures: exposures of the images, electrons per unit of radiance, positive, (pictures,).
        seed: seed of the noise: a whole number, or a key of jax.random.
        times: exposure times of the images, (pictures,), s, which determine the dark signal. Default: None, times of 0, without
            a dark signal.

    Returns:
        The images, DN, shape (pictures, H, W) or (pictures, H, W, channels).

    Raises:
        ArgumentError: an argument is out of range or has the wrong shape.

    Source:
        EMVA Standard 1288, release 4.

    Example:
        >>> sensor = matcam.Sensor(5e-6, full_well=10_000, read_noise=3.0)
        >>> matcam.camera.expose_bracket(sensor, np.ones((2, 3)), [100.0, 1000.0], seed=1).shape
        (2, 2, 3)
    """
    exposures, times = _exposures_and_times(exposures, times)
    checks.instance("sensor", sensor, Sensor)
    pairs = zip(jax.random.split(random_key(seed), len(exposures)), exposures, times, strict=True)
    return jnp.stack([sensor.expose(radiance, exposure, one, time) for one, exposure, time in pairs])


def merge_bracket(
    sensor: Sensor, pictures: AnyArray, exposures: Sequence[float], times: Sequence[float] | None = None
) -> RadianceEstimate:
    """Merge images of one scene into an estimate of its radiance.

    The mean dark signal is subtracted from each image, and the difference is divided by the exposure. The estimate is
    the weighted mean of these values with the smallest variance. Without saturation, the estimate is unbiased, except
    for the weak dependence of the weights on the data.

    Args:
        sensor: sensor of the images; its noise determines the weights.
        pictures: images, DN, shape (pictures, H, W) or (pictures, H, W, channels).
        exposures: exposures of the images, electrons per unit of radiance, positive, (pictures,).
        times: exposure times of the images, (pictures,), s, which determine the dark signal. Default: None, times of 0,
            without a dark signal.

    Returns:
        `.radiance` in the unit of radiance to which the exposures refer, its `.std`, and a mask `.saturated` of pixels
        that are saturated in all images.

    Raises:
        ArgumentError: an argument is out of range or has the wrong shape.

    Source:
        EMVA Standard 1288, release 4 (the variances); docs/model.md 8 (the radiance at which they are evaluated).

    Example:
        >>> sensor = matcam.Sensor(5e-6, full_well=10_000, read_noise=3.0)
        >>> pictures = sensor.black_level + np.array([[[500.0]], [[5000.0]]])  # without noise
        >>> round(float(matcam.camera.merge_bracket(sensor, pictures, [500.0, 5000.0]).radiance[0, 0]), 6)
        1.0
    """
    exposures, times = _exposures_and_times(exposures, times)
    checks.instance("sensor", sensor, Sensor)
    pictures = checks.numbers("pictures", pictures)
    if pictures.shape[:1] != (len(exposures),) or pictures.ndim not in (3, 4):
        raise ArgumentError(
            f"pictures must have shape ({len(exposures)}, H, W) or ({len(exposures)}, H, W, channels), one per exposure, "
            f"got {pictures.shape}"
        )
    column = (-1,) + (1,) * (pictures.ndim - 1)
    exposure, time = (jnp.asarray(a, dtype=jnp.float64).reshape(column) for a in (exposures, times))
    dark = time * sensor.dark_current
    electrons = sensor.electrons(pictures)
    # the weight of an image decreases from 1 to 0 between these shares of saturation
    low, high = 0.85, 0.95
    share = jnp.clip((high - electrons / sensor.saturation) / (high - low), 0, 1)
    usable = share > 0
    saturated = ~jnp.any(usable | jnp.isnan(electrons), axis=0)

    # the mean for shot noise alone requires no initial variance
    weight = share * exposure
    radiance = jnp.sum(share * (electrons - dark), axis=0) / _nan_where_zero(jnp.sum(weight, axis=0))
    # three updates suffice, because the weights depend on the radiance only through its shot noise
    for _ in range(3):
        variance = _variance(sensor, radiance, exposure, dark)
        weight = share / variance
        weight = weight / _nan_where_zero(jnp.sum(weight, axis=0))
        radiance = jnp.sum(weight * (electrons - dark) / exposure, axis=0)
    # patterns are the same in all images, so averaging does not reduce them
    common = (sensor.prnu * radiance) ** 2
    common += (sensor.dark_nonuniformity * jnp.sum(weight * dark / exposure, axis=0)) ** 2
    common += (sensor.dsnu * jnp.sum(weight / exposure, axis=0)) ** 2
    std = jnp.sqrt(jnp.sum(weight**2 * _variance(sensor, radiance, exposure, dark), axis=0) + common)
    return RadianceEstimate(radiance, std, saturated)


def _variance(sensor: Sensor, radiance: jax.Array, exposure: jax.Array, dark: jax.Array) -> jax.Array:
    return sensor.variance(exposure * jnp.maximum(radiance, 0) + dark) / exposure**2


def _nan_where_zero(total: jax.Array) -> jax.Array:
    return jnp.where(total > 0, total, jnp.nan)


def _exposures_and_times(
    exposures: Sequence[float], times: Sequence[float] | None
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    positive = checks.positive(
        "exposures", jnp.atleast_1d(checks.number("exposures", exposures)), "e- per unit of radiance"
    )
    if positive.ndim != 1 or positive.size == 0:
        raise ArgumentError(f"exposures must be a list of at least one number, got shape {positive.shape}")
    strengths = tuple(positive.tolist())
    durations = (
        (0.0,) * len(strengths) if times is None else tuple(jnp.atleast_1d(checks.number("times", times)).tolist())
    )
    if len(durations) != len(strengths):
        raise ArgumentError(
            f"times must have one value for each of the {len(strengths)} exposures, got {len(durations)}"
        )
    checks.within("times", jnp.asarray(durations), 0, float("inf"), "s", open_high=True)
    return strengths, durations
