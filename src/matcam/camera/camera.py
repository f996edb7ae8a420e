"""The camera: lens and pixel together, as the one effective kernel that a picture has been through (MODEL 2)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
from jax.typing import ArrayLike

from matcam.camera import kernel as effective
from matcam.camera import parameters, profile
from matcam.camera.optics.optics import Optics
from matcam.camera.pixel import BoxPixel, PixelResponse
from matcam.camera.sensor import Sensor
from matcam.camera.uncertainty import Provenance, Uncertainty
from matcam.core import checks
from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.jax import is_concrete, jax, jnp
from matcam.core.json import write_json


class Camera(eqx.Module):
    """Effective kernel of a camera: optics and pixel, sampled at pixel centres.

    optics: `Optics`. pixel: `PixelResponse`. A `Camera` is neither, so nothing can be blurred twice.
    sensor: `Sensor`, noise and mosaic of its pictures; None: nobody said. It does not change the kernel.
    uncertainty: how well its parameters are known (`Uncertainty`); None: they are taken as exact.
    provenance: where it comes from; carried by the profile file.

    Angles are those of a direction on the sensor to the pixel grid's rows, rad: a square pixel looks different from
    every angle.
    """

    optics: Optics
    pixel: PixelResponse
    sensor: Sensor | None
    uncertainty: Uncertainty | None
    provenance: Provenance = eqx.field(static=True)

    def __init__(
        self,
        optics: Optics,
        pixel: PixelResponse | None = None,
        sensor: Sensor | None = None,
        *,
        uncertainty: Uncertainty | None = None,
        provenance: Provenance | None = None,
    ):
        pixel = BoxPixel() if pixel is None else pixel
        given: object = optics
        if not isinstance(given, Optics):
            hint = ": a Camera already contains its pixel" if isinstance(given, Camera) else ""
            raise ArgumentError(f"optics must be Optics, got {type(given).__name__}{hint}")
        if not isinstance(pixel, PixelResponse):
            raise ArgumentError(f"pixel must be a PixelResponse, got {type(pixel).__name__}")
        if sensor is not None and not isinstance(sensor, Sensor):
            raise ArgumentError(f"sensor must be a Sensor, got {type(sensor).__name__}")
        self.optics = optics
        self.pixel = pixel
        self.sensor = sensor
        self.uncertainty = uncertainty
        self.provenance = provenance or Provenance()
        if uncertainty is not None:
            uncertainty.check_names(self.parameters())
        if sensor is not None:
            self._check_pitch(sensor.pitch)

    # ------------------------------------------------------------------ the effective kernel

    def psf(self, x: ArrayLike, y: ArrayLike) -> jax.Array:
        """Effective point spread function, 1/px^2: what a pixel reads of a point of light (x, y) px from its centre."""
        x, y = checks.number("x", x), checks.number("y", y)
        return self._sum(lambda part: effective.point(part, self.pixel, x, y))

    def lsf(self, x: ArrayLike, angle: ArrayLike = 0.0) -> jax.Array:
        """Effective line spread function, 1/px: what a pixel reads of a line x px away whose normal is at `angle`."""
        x, angle = checks.number("x", x), checks.number("angle", angle)
        return self._sum(lambda part: effective.line(part, self.pixel, x, angle))

    def esf(self, x: ArrayLike, angle: ArrayLike = 0.0) -> jax.Array:
        """Effective edge spread function: what a pixel x px inside the bright side of a 0-1 edge reads."""
        x, angle = checks.number("x", x), checks.number("angle", angle)
        return self._sum(lambda part: effective.edge(part, self.pixel, x, angle))

    def mtf(self, f: ArrayLike, angle: ArrayLike = 0.0) -> jax.Array:
        """Total transfer function at f cycles/px along `angle`: optics times pixel, signed (the pixel's is negative
        beyond 1 / (2 half_width))."""
        return effective.transfer_along(self.optics, self.pixel, checks.number("f", f), checks.number("angle", angle))

    def transfer(self, fx: jax.Array, fy: jax.Array) -> jax.Array:
        """Total transfer function at (fx, fy) cycles/px."""
        return effective.transfer(self.optics, self.pixel, fx, fy)

    def _sum(self, kernel: Callable[[Optics], jax.Array]) -> jax.Array:
        """Kernels are linear in the lens: each part by the best route that it has."""
        return sum((weight * kernel(part) for weight, part in self.optics.components()), jnp.zeros(()))

    # ------------------------------------------------------------------ its numbers and its file

    def parameters(self) -> dict[str, jax.Array]:
        """Numbers that describe the camera, by their names in the profile: scalars, one per entry."""
        return {**parameters.numbers("optics", self.optics), **parameters.numbers("pixel", self.pixel)}

    def with_parameters(self, values: dict[str, Any]) -> Camera:
        """The same camera with some of its `parameters()` replaced."""
        known = self.parameters()
        for name in values:
            if name not in known:
                raise ArgumentError(f"this camera has no parameter {name!r}; it has {', '.join(sorted(known))}")
        new = tuple(parameters.replaced(part, getattr(self, part), values) for part in ("optics", "pixel"))
        return eqx.tree_at(lambda c: (c.optics, c.pixel), self, new)

    def save(self, path: str | Path, *, force: bool = False) -> None:
        """Write the profile (JSON, see `profile`): kernel, sensor, uncertainty, provenance. OutputError where it cannot go."""
        write_json(path, self.profile(), force=force)

    @classmethod
    def load(cls, path: str | Path) -> Camera:
        """Read a profile. FileFormatError naming the file and the field where it is not one."""
        return cls._from_parts(profile.read(path), path)

    def profile(self) -> dict[str, Any]:
        """The profile as JSON (dicts, lists, numbers, texts), to be embedded in another file."""
        return profile.as_document(self.optics, self.pixel, self.sensor, self.uncertainty, self.provenance)

    @classmethod
    def from_profile(cls, document: Any, where: str | Path = "camera profile") -> Camera:
        """The camera of a `profile()`. FileFormatError naming `where` it stands, and the field."""
        return cls._from_parts(profile.from_document(document, where), where)

    @classmethod
    def _from_parts(cls, parts: dict[str, Any], where: str | Path) -> Camera:
        try:
            return cls(**parts)
        except ArgumentError as error:
            raise FileFormatError(f"{where}: {error}") from None

    def _check_pitch(self, pitch: jax.Array) -> None:
        """A lens in m and a sensor in m must speak of the same pixels."""
        for name, value in self.parameters().items():
            if not name.endswith("pixel_pitch_m") or not is_concrete(value) or not is_concrete(pitch):
                continue
            if abs(float(value) / float(pitch) - 1) > 1e-6:
                raise ArgumentError(f"sensor has a pitch of {pitch:g} m, but {name} is {value:g}: give both the same")

    def __repr__(self) -> str:
        sensor = "" if self.sensor is None else f", {self.sensor!r}"
        uncertainty = "" if self.uncertainty is None else f", uncertainty={self.uncertainty!r}"
        return f"Camera({self.optics!r}, {self.pixel!r}{sensor}{uncertainty})"
