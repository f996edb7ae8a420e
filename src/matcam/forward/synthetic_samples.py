"""Samples of synthetic captures: sphere, cylinder and textured flat sample, each with lamps, images and outline."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple, Protocol

import numpy as np

from matcam.core.errors import ArgumentError
from matcam.core.jax import jnp
from matcam.forward.image import picture
from matcam.forward.texture import textured_picture
from matcam.lamp.lamps import NearLamp
from matcam.material.material import Material
from matcam.rigs import Rig
from matcam.sample.curved import Cylinder, Sphere
from matcam.sample.shape import Curved, Flat

RADIUS_MM = 25.0
"""Radius of a simulated sphere or cylinder, mm."""
MARGIN = 48
"""Width of the border of an image beside a curved sample, px. The border contains the reference."""
_ROWS = 96
"""Height of a cylinder's image, px."""
_LAMP_OF_FLAT = math.radians(20)
"""Angle between the fixed lamp and the optical axis for a flat sample, rad. The tilts of the sample, up to 40
degrees, then yield half angles from 10 degrees through 0 to 30 degrees.
"""
_TEXTURE_SLOPE = -2.0
"""Exponent of frequency in the power spectrum of the textures, as in natural images (van der Schaaf and van Hateren 1996)."""


class LampErrors(NamedTuple):
    """Standard deviations of the errors of a synthetic capture.

    Attributes:
        direction: standard deviation of the specified lamp direction, rad.
        gain: relative standard deviation of the intensity of the lamp, no unit.
        shift: standard deviation of the position of the sample, px.
    """

    direction: float
    gain: float
    shift: float


class SyntheticSample(Protocol):
    """Sample in a synthetic capture, with its effect on the images and on capture.toml."""

    shape: tuple[int, int]
    may_clip: bool
    """True if pixels may clip in longer exposures. Images of a flat sample are Fourier transformed, which requires the values
    of all pixels.
    """

    def lamps(
        self, theta_d: np.ndarray, azimuth: float, errors: LampErrors, rng: np.random.Generator
    ) -> Iterator[dict[str, Any]]:
        """Generate a dictionary for each lamp position: true and specified direction, intensity, and shift of the sample."""

    def drawn(self, material: Material, lamp: dict[str, Any], error: float) -> np.ndarray:
        """Compute the radiance of one lamp position, (height, width, channels), 1/sr."""

    def before_field(self, shift: np.ndarray) -> np.ndarray | None:
        """Compute the share of each pixel that the bright field behind the sample covers; None if the sample has no outline.

        shift: shift of the sample, (right, down), px.
        """

    def settings(self) -> dict[str, Any]:
        """Build the section [sample] of capture.toml."""


def synthetic_sample(rig: Rig, shape: tuple[int, int] | None, seed: int) -> SyntheticSample:
    """Build the synthetic sample of a rig.

    Args:
        rig: camera, sample and lamp.
        shape: (height, width) of the images of a flat sample, px; None: 256 x 256. Must be None for a curved sample.
        seed: seed of a flat sample's textures.

    Raises:
        ArgumentError: the sample is not a sphere, a cylinder or flat; a shape is given for a curved sample; or a flat sample
            has a near lamp or a sensor with a mosaic.
    """
    if isinstance(rig.sample, Flat):
        return _FlatSample(rig, shape or (256, 256), seed)
    if shape is not None:
        raise ArgumentError(
            "the size of the images of a sphere or cylinder follows from the radius: omit the size (shape)"
        )
    if isinstance(rig.sample, Sphere):
        return _SphereSample(rig, rig.sample)
    if isinstance(rig.sample, Cylinder):
        return _CylinderSample(rig, rig.sample)
    raise ArgumentError(
        f"a synthetic capture needs a Sphere, a Cylinder or a Flat sample, got a {type(rig.sample).__name__}"
    )


def _lamp(
    number: int, angle: float, azimuth: float, errors: LampErrors, rng: np.random.Generator, **more: Any
) -> dict[str, Any]:
    sin = math.sin(angle)
    wrong = errors.direction * rng.standard_normal(2) / [1, max(sin, 0.05)]
    stated = np.degrees([min(max(angle + wrong[0], 0.0), math.pi), azimuth + wrong[1]])
    return {
        "lamp": f"L{number + 1:02d}",
        "direction": [sin * math.cos(azimuth), sin * math.sin(azimuth), math.cos(angle)],
        "angle_deg": math.degrees(angle),
        "azimuth_deg": math.degrees(azimuth),
        **more,
        "gain": math.exp(errors.gain * rng.standard_normal()),
        "shift_px": (errors.shift * rng.standard_normal(2)).tolist(),
        "stated_deg": stated.tolist(),
    }


class _CurvedSample:
    """Sphere or cylinder on the optical axis."""

    may_clip = True

    def __init__(self, rig: Rig, shape: tuple[int, int]):
        assert isinstance(rig.sample, Curved)
        self.rig, self.sample, self.shape = rig, rig.sample, shape

    @property
    def radius(self) -> float:
        return float(self.sample.radius)

    def lamps(
        self, theta_d: np.ndarray, azimuth: float, errors: LampErrors, rng: np.random.Generator
    ) -> Iterator[dict[str, Any]]:
        angles = np.asarray(self.sample.lamp_angle(jnp.asarray(theta_d, dtype=float), self.rig.lamp.nearness))
        for number, (angle, theta) in enumerate(zip(angles, theta_d, strict=True)):
            yield _lamp(number, float(angle), azimuth, errors, rng, theta_d_deg=math.degrees(float(theta)))

    def drawn(self, material: Material, lamp: dict[str, Any], error: float) -> np.ndarray:
        angle, azimuth = math.radians(lamp["angle_deg"]), math.radians(lamp["azimuth_deg"])
        shift = (lamp["shift_px"][0], lamp["shift_px"][1])
        image = picture(material, self.rig, angle, azimuth, shape=self.shape, shift=shift, error=error).values
        return image if image.ndim == 3 else image[..., None]

    def _past_edge(self, beyond: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Compute the share of each pixel that a bright field beyond a straight edge covers.

        Args:
            beyond: distance of the pixel from the edge, px, positive on the side of the field.
            angle: direction of the normal of the edge, rad.
        """
        out = (beyond > 0).astype(float)
        near = np.abs(beyond) < 12
        # the symmetry of a square pixel reduces all directions to [0, pi / 4]
        turned = np.minimum(np.mod(angle, np.pi / 2), np.pi / 2 - np.mod(angle, np.pi / 2))[near]
        steps = np.linspace(0, np.pi / 4, 9)
        curves = np.stack([np.asarray(self.rig.camera.esf(np.linspace(-12, 12, 481), angle=a)) for a in steps])
        from scipy.interpolate import RegularGridInterpolator

        read = RegularGridInterpolator((steps, np.linspace(-12, 12, 481)), curves)
        out[near] = read(np.stack([np.clip(turned, 0, np.pi / 4), np.clip(beyond[near], -12, 12)], -1))
        return np.clip(out, 0, 1)

    def _from_centre(self, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rows, columns = np.indices(self.shape)
        return columns - (self.shape[1] - 1) / 2 - shift[0], (self.shape[0] - 1) / 2 + shift[1] - rows


class _SphereSample(_CurvedSample):
    def __init__(self, rig: Rig, sphere: Sphere):
        side = 2 * (math.ceil(float(sphere.radius)) + MARGIN)
        super().__init__(rig, (side, side))

    def before_field(self, shift: np.ndarray) -> np.ndarray:
        """Compute the share of each pixel that the bright field covers.

        The limb is treated as straight, because its radius is hundreds of pixels.
        """
        x, y = self._from_centre(shift)
        return self._past_edge(np.hypot(x, y) - self.radius, np.arctan2(y, x))

    def settings(self) -> dict[str, Any]:
        return {"kind": "sphere", "radius_mm": [RADIUS_MM, 0.005]}


class _CylinderSample(_CurvedSample):
    """Strip of material around an upright cylinder."""

    def __init__(self, rig: Rig, cylinder: Cylinder):
        super().__init__(rig, (_ROWS, 2 * (math.ceil(float(cylinder.radius)) + MARGIN)))

    def before_field(self, shift: np.ndarray) -> np.ndarray:
        x, _ = self._from_centre(shift)
        return self._past_edge(np.abs(x) - self.radius, np.zeros(self.shape))

    def settings(self) -> dict[str, Any]:
        # the lens mixes the strip with its neighbours above and below
        return {
            "kind": "cylinder",
            "radius_mm": [RADIUS_MM, 0.005],
            "strip_rows_px": [[0, _ROWS - 1]],
            "centre_row_px": [(_ROWS - 1) / 2, 1.0],
        }


class _FlatSample:
    """Flat sample with textures of diffuse albedo and specular strength, tilted under a fixed distant lamp."""

    may_clip = False

    def __init__(self, rig: Rig, shape: tuple[int, int], seed: int):
        if isinstance(rig.lamp, NearLamp):
            raise ArgumentError(
                "a flat sample is simulated under a distant lamp: omit the lamp distance, or use DistantLamp()"
            )
        if rig.camera.sensor is not None and rig.camera.sensor.cfa is not None:
            raise ArgumentError("a flat sample needs a grey sensor: give a camera whose sensor has no cfa")
        self.rig, self.shape = rig, shape
        rng = np.random.default_rng(seed + 1_000_000)
        size = (2 * shape[0], 2 * shape[1])  # an image of the tilted sample shows a larger part of the texture
        # relative standard deviations of the diffuse and of the specular texture
        self.textures = [1 + contrast * _noise(size, rng) for contrast in (0.2, 0.3)]
        self._tilts: list[float] = []

    def lamps(
        self, theta_d: np.ndarray, azimuth: float, errors: LampErrors, rng: np.random.Generator
    ) -> Iterator[dict[str, Any]]:
        tilts = np.linspace(0, math.radians(40), len(theta_d))
        self._tilts = np.degrees(tilts).round(6).tolist()
        half = math.degrees(_LAMP_OF_FLAT / 2)
        exact = errors._replace(direction=0.0, shift=0.0)  # reconstruct assumes that both are exact
        for number, tilt in enumerate(self._tilts):
            yield _lamp(number, _LAMP_OF_FLAT, azimuth, exact, rng, theta_d_deg=half, tilt_deg=tilt)

    def drawn(self, material: Material, lamp: dict[str, Any], error: float) -> np.ndarray:
        tilt = math.radians(lamp["tilt_deg"])
        shiny, diffuse = _weights(material, tilt, np.array(lamp["direction"]))
        light = diffuse * self.textures[0] + shiny * self.textures[1]
        return np.asarray(textured_picture(np.maximum(light, 0), self.rig, tilt, self.shape))[..., None]

    def before_field(self, shift: np.ndarray) -> None:
        return None

    def settings(self) -> dict[str, Any]:
        return {"kind": "flat", "tilt_deg": self._tilts, "mm_per_px": 0.02}


def _noise(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Generate a periodic random texture, band-limited to 0.45 cycles per texel, with mean 0 and standard deviation 1."""
    frequency = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.fftfreq(shape[1]))
    amplitude = np.maximum(frequency, 2 / min(shape)) ** (_TEXTURE_SLOPE / 2) * (frequency < 0.45)
    amplitude[0, 0] = 0.0
    values = np.fft.ifft2(np.fft.fft2(rng.standard_normal(shape)) * amplitude).real
    return np.asarray(values / values.std())


def _weights(material: Material, tilt: float, towards: np.ndarray) -> tuple[float, float]:
    """Compute the radiance of lobe and diffuse part where both textures are 1, 1/sr, averaged over the channels.

    tilt: tilt of the sample, rad. towards: unit vector to the lamp.
    """
    normal, view = np.array([math.sin(tilt), 0.0, math.cos(tilt)]), np.array([0.0, 0.0, 1.0])
    half = (towards + view) / np.linalg.norm(towards + view)
    cos_i = max(float(normal @ towards), 0.0)
    theta_h, theta_d = (math.acos(min(max(float(a @ half), -1.0), 1.0)) for a in (normal, towards))
    across, along = normal - (normal @ half) * half, towards - (towards @ half) * half
    size = float(np.linalg.norm(across) * np.linalg.norm(along))
    phi_d = math.acos(min(max(float(across @ along) / size, -1.0), 1.0)) if size > 1e-12 else 0.0
    albedo = float(np.mean(np.asarray(getattr(material, "diffuse", 0.0))))
    whole = float(np.mean(np.asarray(material.brdf(theta_h, theta_d, phi_d))))
    return cos_i * (whole - albedo / math.pi), cos_i * albedo / math.pi
