"""Camera: lens and pixel, combined to the effective kernel of its images (docs/model.md 2)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matcam.camera import kernel as effective
from matcam.camera.lens_field import LensField
from matcam.camera.optics.optics import Optics
from matcam.camera.parameters import Provenance, Uncertainty, parameters_of, rebuilt, replace_parameters
from matcam.camera.pixel import BoxPixel, PixelResponse
from matcam.camera.sensor import Sensor
from matcam.core import checks
from matcam.core.arrays import is_concrete, xp
from matcam.core.arrays.module import Module, replaced, static_field
from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.io import write_json
from matcam.core.results.summary import Quantity, Summarised, Summary, parameters

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import jax


class Camera(Module, Summarised):
    """Lens and pixel, combined to the effective kernel of a camera's images.

    Three kernels are easily confused. `Optics.psf` is the irradiance on the sensor that a point source causes through
    the lens. `PixelResponse.response` is the sensitivity of one pixel over its area. `Camera.psf` is the *effective*
    kernel that pixels record: the irradiance, weighted with the sensitivity and integrated over a pixel. A `Camera` is
    neither an `Optics` nor a `PixelResponse`, so that no blur can be applied twice.

    Directions are angles from the rows of the pixel grid, rad, from +x (right) towards +y (up). The direction also
    matters for an isotropic lens, because a square pixel is not isotropic.

    Args:
        optics: the lens, such as `GaussianOptics(0.5)`.
        pixel: the response of one pixel. Default: None, `BoxPixel()`, which is uniformly sensitive.
        sensor: noise and mosaic of the images, which do not change the kernel. Default: None, the sensor is unknown.
        uncertainty: covariance of the parameters of the camera. Default: None, the parameters are exact.
        provenance: origin of the camera, for the profile. Default: None, the origin is unknown.
        field: distortion and growth of the blur over the field, which `reconstruct` uses. Default: None, the blur is
            uniform, without distortion.

    Raises:
        ArgumentError: a part is of the wrong kind, `uncertainty` names a parameter that the camera lacks, or lens and
            sensor have different pixel pitches.

    Source:
        Holzschuch & Pacanowski (2017), section 3; docs/model.md 2.

    Example:
        >>> camera = matcam.Camera(matcam.GaussianOptics(0.5), matcam.BoxPixel())
        >>> bool(camera.mtf(0.25) < camera.optics.mtf(0.25))  # the pixel blurs, too
        True
        >>> print(camera.summary())
        [[GaussianOptics on BoxPixel]]
        [[Parameters]]
            optics.sigma_px:     0.5
            pixel.half_width_px: 0.5
        [[Lens and pixel together]]
            MTF50 along the rows: 0.323088 cycles/px
    """

    optics: Optics
    pixel: PixelResponse
    sensor: Sensor | None
    uncertainty: Uncertainty | None
    provenance: Provenance = static_field()
    field: LensField | None = static_field()

    def __init__(
        self,
        optics: Optics,
        pixel: PixelResponse | None = None,
        sensor: Sensor | None = None,
        *,
        uncertainty: Uncertainty | None = None,
        provenance: Provenance | None = None,
        field: LensField | None = None,
    ):
        pixel = BoxPixel() if pixel is None else pixel
        given: object = optics
        if not isinstance(given, Optics):
            hint = ": a Camera already contains its pixel; give camera.optics" if isinstance(given, Camera) else ""
            raise ArgumentError(f"optics must be Optics, got {type(given).__name__}{hint}")
        if not isinstance(pixel, PixelResponse):
            raise ArgumentError(f"pixel must be a PixelResponse, got {type(pixel).__name__}")
        if sensor is not None and not isinstance(sensor, Sensor):
            raise ArgumentError(f"sensor must be a Sensor, got {type(sensor).__name__}")
        self.optics = optics
        self.pixel = pixel
        self.sensor = sensor
        self.uncertainty = uncertainty
        self.provenance = Provenance() if provenance is None else checks.instance("provenance", provenance, Provenance)
        self.field = field
        if uncertainty is not None:
            checks.instance("uncertainty", uncertainty, Uncertainty).check_names(self.parameters())
        if sensor is not None:
            self._check_pitch(sensor.pitch)

    # ------------------------------------------------------------------ the effective kernel

    def psf(self, x: ArrayLike, y: ArrayLike) -> jax.Array:
        """Compute the effective point spread function of optics and pixel, 1/px^2.

        It is the value of a pixel for a point source of unit flux, and integrates to 1.

        Args:
            x: distance of the point from the centre of the pixel along the rows, px; broadcasts with y.
            y: distance across the rows, upwards, px.

        Raises:
            ArgumentError: a position is not finite, or a measured MTF does not end at 0.
        """
        x, y = checks.broadcastable(x=x, y=y)
        return self._sum(lambda part: effective.point(part, self.pixel, x, y))

    def lsf(self, x: ArrayLike, angle: ArrayLike = 0.0) -> jax.Array:
        """Compute the effective line spread function of optics and pixel, 1/px.

        It is the value of a pixel for a line source of unit flux per px.

        Args:
            x: distance of the line from the centre of the pixel, px; broadcasts with angle.
            angle: angle between the rows and the normal of the line, rad. Default: 0, a line along the columns.

        Raises:
            ArgumentError: an argument is not finite, or a measured MTF does not end at 0.
        """
        x, angle = checks.broadcastable(x=x, angle=angle)
        return self._sum(lambda part: effective.line(part, self.pixel, x, angle))

    def esf(self, x: ArrayLike, angle: ArrayLike = 0.0) -> jax.Array:
        """Compute the effective edge spread function of optics and pixel, no unit.

        It is the value of a pixel at an edge between a dark side of value 0 and a bright side of value 1.

        Args:
            x: distance of the centre of the pixel from the edge, px, positive on the bright side of the edge;
                broadcasts with angle.
            angle: angle between the rows and the normal of the edge, rad. Default: 0, an edge along the columns.

        Raises:
            ArgumentError: an argument is not finite, or a measured MTF does not end at 0.
        """
        x, angle = checks.broadcastable(x=x, angle=angle)
        return self._sum(lambda part: effective.edge(part, self.pixel, x, angle))

    def mtf(self, f: ArrayLike, angle: ArrayLike = 0.0) -> jax.Array:
        """Compute the signed transfer function of optics and pixel.

        The factor of a `BoxPixel` changes sign at 1 / (2 half_width), cycles/px. If the lens is not isotropic, the
        result is the modulus; `transfer` includes the phase.

        Args:
            f: frequency, cycles/px; broadcasts with angle.
            angle: angle between the rows and the direction of the wave, rad. Default: 0, along the rows.

        Raises:
            ArgumentError: an argument is not finite, or f lies beyond the range of a measured MTF.
        """
        f, angle = checks.broadcastable(f=f, angle=angle)
        along = effective.transfer_along(self.optics, self.pixel, f, angle)
        return along if self.optics.isotropic else xp.abs(along)

    def transfer(self, fx: jax.Array, fy: jax.Array) -> jax.Array:
        """Compute the signed transfer function of optics and pixel in the plane.

        The result is complex if the lens is not isotropic.

        Args:
            fx: frequency along the rows, cycles/px; broadcasts with fy.
            fy: frequency across the rows, upwards, cycles/px.
        """
        return effective.transfer(self.optics, self.pixel, fx, fy)

    def _sum(self, kernel: Callable[[Optics], jax.Array]) -> jax.Array:
        """Sum a kernel over the components of the lens, because the kernel is linear in the lens."""
        return sum((weight * kernel(part) for weight, part in self.optics.components()), xp.zeros(()))

    # ------------------------------------------------------------------ parameters and profile

    def parameters(self) -> dict[str, jax.Array]:
        """List the parameters of lens and pixel by name.

        Returns:
            Scalars by names with their units, such as "optics.sigma_px" and "pixel.half_width_px".
        """
        return {**parameters_of("optics", self.optics), **parameters_of("pixel", self.pixel)}

    def with_parameters(self, values: dict[str, Any]) -> Camera:
        """Build a camera with some of the `parameters()` replaced.

        Args:
            values: new values by name, numbers in the units of the names.

        Raises:
            ArgumentError: `values` is not a dict, names a parameter that the camera lacks, or contains a value that the lens or
                the pixel cannot have.
        """
        known = self.parameters()
        for name, value in checks.instance("values", values, dict).items():
            if name not in known:
                raise ArgumentError(f"this camera has no parameter {name!r}; it has {', '.join(sorted(known))}")
            checks.scalar(name, checks.number(name, value))
        camera = camera_with(self, values)
        for part in (camera.optics, camera.pixel):
            rebuilt(part)
        return camera

    def with_field(self, field: LensField | None) -> Camera:
        """Build a camera with another distortion and blur over the field.

        Args:
            field: variation of the lens over the field; None: uniform.
        """
        return dataclasses.replace(self, field=field)

    def with_sensor(self, sensor: Sensor | None) -> Camera:
        """Build a camera with another sensor.

        Args:
            sensor: noise and mosaic, such as the result of `SensorCharacteristics.sensor`; None: unknown.

        Raises:
            ArgumentError: lens and sensor have different pixel pitches.
        """
        return dataclasses.replace(self, sensor=sensor)

    def save(self, path: str | Path, *, force: bool = False) -> None:
        """Write the camera's profile: lens, pixel, sensor, field, uncertainty, provenance.

        Args:
            path: file to write (JSON).
            force: replace an existing file (no unit). Default: False.

        Raises:
            OutputError: the file exists, or cannot be written.
        """
        write_json(path, self.profile(), force=force)

    @classmethod
    def load(cls, path: str | Path) -> Camera:
        """Read a camera's profile.

        Args:
            path: file to read (JSON), of any published version.

        Raises:
            FileFormatError: the file is not a profile; the message names the file and the field.
        """
        from matcam.camera import profile  # imports pydantic, which few cameras require

        return cls._from_parts(profile.read_profile(path), path)

    def profile(self) -> dict[str, Any]:
        """Build the profile as JSON, which other files can contain.

        Returns:
            Nested dicts and lists of numbers and strings.
        """
        from matcam.camera import profile

        return profile.as_document(self.optics, self.pixel, self.sensor, self.field, self.uncertainty, self.provenance)

    @classmethod
    def from_profile(cls, document: Any, where: str | Path = "camera profile") -> Camera:
        """Build a camera from its `profile()`.

        Args:
            document: the profile as JSON.
            where: location of the profile, for messages. Default: "camera profile".

        Raises:
            FileFormatError: the document is not a profile; the message names its location and the field.
        """
        from matcam.camera import profile

        return cls._from_parts(profile.from_document(document, where), where)

    @classmethod
    def _from_parts(cls, parts: dict[str, Any], where: str | Path) -> Camera:
        try:
            return cls(**parts)
        except ArgumentError as error:
            raise FileFormatError(f"{where}: {error}") from None

    def _check_pitch(self, pitch: jax.Array) -> None:
        for name, value in self.parameters().items():
            if not name.endswith("pixel_pitch_m") or not is_concrete(value) or not is_concrete(pitch):
                continue
            if abs(float(value) / float(pitch) - 1) > 1e-6:
                raise ArgumentError(
                    f"sensor has a pitch of {pitch:g} m, but {name} is {value:g} m: specify the same pitch"
                )

    def _summary(self) -> Summary:
        std = self.uncertainty.std() if self.uncertainty else {}
        stated = dataclasses.asdict(self.provenance)
        sections = {
            "Parameters": parameters(self.parameters(), std),
            "Lens and pixel together": [
                Quantity(f"MTF50 along the rows{f', {name}' if name else ''}", value, unit="cycles/px")
                for name, value in effective.mtf50(self.optics, self.pixel).items()
            ],
            "Sensor": [] if self.sensor is None else [Quantity("noise and mosaic", repr(self.sensor))],
            "Provenance": [Quantity(name, text) for name, text in stated.items() if text],
        }
        return Summary(f"{type(self.optics).__name__} on {type(self.pixel).__name__}", sections=sections)

    def __repr__(self) -> str:
        sensor = "" if self.sensor is None else f", {self.sensor!r}"
        uncertainty = "" if self.uncertainty is None else f", uncertainty={self.uncertainty!r}"
        field = "" if self.field is None else f", field={self.field!r}"
        return f"Camera({self.optics!r}, {self.pixel!r}{sensor}{uncertainty}{field})"


def camera_with(camera: Camera, values: Mapping[str, Any]) -> Camera:
    """Replace parameters without checks of their ranges. In a fit, a width may be 0.

    values: new values by name, in the units of the names; names of other parameters are ignored.
    """
    found = camera
    for part in ("optics", "pixel"):
        found = replaced(found, part, replace_parameters(part, getattr(camera, part), values))
    return found
