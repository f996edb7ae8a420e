"""Rig of a measurement (camera, sample and lamp), and rigs of published measurements."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from matcam.camera.camera import Camera
from matcam.camera.optics.colour import ColourOptics
from matcam.camera.optics.gaussian import GaussianOptics
from matcam.camera.parameters import Provenance, Uncertainty
from matcam.camera.pixel import BoxPixel
from matcam.core import checks
from matcam.core.arrays import is_concrete, xp
from matcam.core.arrays.module import Module, replaced, static_field
from matcam.core.errors import ArgumentError
from matcam.core.grid import GRID_SHAPE
from matcam.lamp.lamps import DistantLamp, Lamp, NearLamp, checked_azimuth, checked_azimuths, closeness
from matcam.sample.curved import Sphere
from matcam.sample.shape import Curved, Sample

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import jax

CellValue = Literal["centre", "edge", "mean", "nearest", "bilinear", "unknown"]
UNKNOWN: CellValue = "unknown"
"""Unknown meaning of a cell. A fit determines the meaning from the table; in a simulated table each cell has its own pixel."""
CELL_VALUES: tuple[CellValue, ...] = tuple(value for value in get_args(CellValue) if value != UNKNOWN)
"""Meaning of a cell of a table: pixel at its centre, pixel at its edge, mean of the pixels inside, nearest pixel of a
real image, or bilinear interpolation between the pixels of a real image. At a sharp peak these values differ by up to
45 % (docs/model.md 3).
"""
ON_REAL_PIXELS: tuple[CellValue, ...] = ("nearest", "bilinear")
"""Meanings that require a real grid of pixels, whose phase is specified or estimated from the table."""


PixelPhase = tuple[float, float] | tuple[tuple[float, float], ...]
"""Position of the real pixels, px: (x, y), or a pair for each slice of theta_d."""


class Rig(Module):
    """Camera, sample and lamp that measure a material.

    Args:
        camera: camera, with its uncertainty if it is known.
        sample: shape of the sample: `Sphere`, `Cylinder` or `Flat`.
        lamp: light source, `DistantLamp` or `NearLamp`. Default: None, a distant point.
        lamp_radius: angular radius of a distant lamp, instead of `lamp`, rad, [0, pi/8]. Default: None, that of `lamp`.
        jitter: standard deviation of the registration of the images, px, [0, 10]. Default: 0. Increase it if several
            exposures are merged or the rig vibrates.
        aperture: diameter of the entrance pupil divided by its distance from the sample, no unit, [0, 1]. Default: 0, no
            defocus.
        focus: angle from the optical axis of the normals that are in focus, rad, [0, pi/2]. Default: 0, the point of the
            sample closest to the camera.
        crop: (height, width) of the part of the sensor that is used, px, about the optical axis. Default: None,
            the area of the sample.
        cell_value: meaning of a cell of the recorded table. "centre" or "edge": the pixel at the centre or the edge of
            the cell; "mean": the mean of the pixels inside the cell, or the nearest pixel if the cell contains no pixel;
            "nearest": the pixel whose centre is nearest to the cell; "bilinear": the interpolation between four pixels;
            "unknown": a fit estimates the meaning from the table. "centre" is used if the table does not determine the
            meaning, and for a simulated table. Default: "centre".
        pixel_phase: position (x, y) of the real pixels, px, each coordinate in [-0.5, 0.5], for "nearest", "bilinear" and
            "mean". The coordinates of the centres of the pixels, relative to the centre of the sphere, are whole numbers
            plus (x, y). 90 such pairs specify one phase for the image of each slice of theta_d. Default: None, a fit
            estimates the phase from the table. If `cell_value` is "mean" and the table does not determine the phase, the
            fit averages over all phases.
        lamp_azimuth: azimuth of the lamp about the optical axis, from +x towards +y, rad, in [-2 pi, 2 pi]. It applies to
            single images and to the images from which a table is made. The pixels do not rotate with the lamp. Default:
            None, attrs["lamp_azimuth"] of the table, or 0.

    Raises:
        ArgumentError: a part is of the wrong kind, or a parameter is out of range.

    Source:
        Holzschuch & Pacanowski (2017), section 3; docs/model.md 3.

    Example:
        >>> camera = matcam.Camera(matcam.GaussianOptics(0.5))
        >>> rig = matcam.Rig(camera, matcam.Sphere(400.0), lamp_radius=0.004)
        >>> float(rig.sample.radius)
        400.0
    """

    camera: Camera
    sample: Sample
    lamp: Lamp
    jitter: jax.Array
    aperture: jax.Array
    focus: jax.Array
    crop: tuple[int, int] | None = static_field()
    cell_value: CellValue = static_field()
    pixel_phase: PixelPhase | None = static_field()
    lamp_azimuth: float | None = static_field()

    def __init__(
        self,
        camera: Camera,
        sample: Sample,
        lamp: Lamp | None = None,
        *,
        lamp_radius: ArrayLike | None = None,
        jitter: ArrayLike = 0.0,
        aperture: ArrayLike = 0.0,
        focus: ArrayLike = 0.0,
        crop: tuple[int, int] | None = None,
        cell_value: CellValue = "centre",
        pixel_phase: PixelPhase | None = None,
        lamp_azimuth: float | None = None,
    ):
        if not isinstance(camera, Camera):
            raise ArgumentError(f"camera must be a Camera (optics and pixel), got {type(camera).__name__}")
        if not isinstance(sample, Sample):
            raise ArgumentError(f"sample must be a Sphere, Cylinder or Flat, got {type(sample).__name__}")
        if lamp is not None and lamp_radius is not None:
            raise ArgumentError("lamp_radius is that of a distant lamp: give lamp_radius or lamp, not both")
        if lamp is None:
            lamp = DistantLamp(0.0 if lamp_radius is None else lamp_radius)
        if not isinstance(lamp, Lamp):
            raise ArgumentError(f"lamp must be a DistantLamp or NearLamp, got {type(lamp).__name__}")

        def number(name: str, value: ArrayLike, high: float, unit: str = "") -> jax.Array:
            return checks.scalar(name, checks.within(name, value, 0, high, unit))

        self.camera = camera
        self.sample = sample
        self.lamp = lamp
        self.jitter = number("jitter", jitter, 10, "px")
        self.aperture = number("aperture", aperture, 1)
        self.focus = number("focus", focus, np.pi / 2, "rad")
        self.crop = None if crop is None else picture_shape("crop", crop)
        self.cell_value = checks.choice("cell_value", cell_value, (*CELL_VALUES, UNKNOWN))
        self.pixel_phase = None if pixel_phase is None else _checked_phase(pixel_phase, cell_value)
        self.lamp_azimuth = None if lamp_azimuth is None else checked_azimuth(lamp_azimuth, "lamp_azimuth")

    @property
    def lamp_radius(self) -> jax.Array:
        """Angular radius of the lamp, seen from the sample, rad."""
        return self.lamp.angular_radius

    @property
    def colours(self) -> tuple[Rig, ...]:
        """Rigs of the colour channels, each with its own lens.

        If the lens is achromatic, the only rig is this one.
        """
        optics = self.camera.optics
        if not isinstance(optics, ColourOptics):
            return (self,)
        exact = replaced(self, "camera.uncertainty", None)  # its parameters are those of all lenses
        return tuple(replaced(exact, "camera.optics", lens) for lens in optics.lenses)

    def azimuths(self, azimuth: ArrayLike | None = None) -> jax.Array:
        """Check azimuths of the lamp, rad, and convert them to an array.

        Args:
            azimuth: azimuths in [-2 pi, 2 pi], rad, any shape. Default: None, `lamp_azimuth` of the rig, or 0, towards
                +x.

        Raises:
            ArgumentError: an azimuth is out of its range.

        Example:
            >>> float(matcam.Rig(matcam.rigs.merl().camera, matcam.Sphere(256.0), lamp_azimuth=0.5).azimuths())
            0.5
        """
        return checked_azimuths((self.lamp_azimuth or 0.0) if azimuth is None else azimuth)

    def px_per_rad(self, theta_d: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Compute the shift of the image per rotation of the normal, px/rad.

        The rotation is relative to the half vector, which also rotates for a near camera or lamp.

        Args:
            theta_d: half the angle between lamp and camera, seen from the highlight, rad, any shape.

        Returns:
            Shift in the plane of camera and lamp and perpendicular to it; infinite for a constant normal.
        """
        return self.sample.px_per_rad(theta_d, self.lamp.nearness)

    def lamp_spread(self, theta_d: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Compute the spread of the half vector over the source disc, rad.

        The disc of a near lamp appears larger from the highlight than from the centre of the sample.

        Args:
            theta_d: difference angle, rad, any shape.

        Returns:
            Standard deviations of the angle of the normal in the plane of camera and lamp, and across it (docs/model.md
            3).
        """
        quarter = self.lamp_radius / 4 * closeness(self.lamp.nearness, xp.cos(theta_d))
        return quarter, quarter / xp.cos(theta_d)

    def description(self) -> dict[str, Any]:
        """Build the description of the rig for an image sidecar.

        Returns:
            Sections "camera", "sample" and "blur", and the angular radius and the distance of the lamp. The names contain
            the units. A distance of None is infinite.
        """
        sample: dict[str, Any] = {"kind": self.sample.kind}
        if isinstance(self.sample, Curved):
            distance = None if self.sample.distant else float(self.sample.distance)
            sample |= {"radius_px": float(self.sample.radius), "distance_radii": distance}
        far = self.lamp.distance if isinstance(self.lamp, NearLamp) else None
        return {
            "camera": self.camera.profile(),
            "sample": sample,
            "blur": {
                "jitter_px": float(self.jitter),
                "aperture": float(self.aperture),
                "focus_rad": float(self.focus),
            },
            "lamp_radius_rad": float(self.lamp_radius),
            "lamp_distance_radii": None if far is None else float(far),
        }

    def __repr__(self) -> str:
        more = "".join(
            f", {name}={value!s}"
            for name, value in (("jitter", self.jitter), ("aperture", self.aperture), ("focus", self.focus))
            if not is_concrete(value) or value != 0
        )
        more += f", crop={self.crop}" if self.crop else ""
        more += f", cell_value={self.cell_value!r}" if self.cell_value != "centre" else ""
        if self.pixel_phase is not None:
            several = isinstance(self.pixel_phase[0], tuple)
            more += ", pixel_phase=" + (f"{len(self.pixel_phase)} pairs" if several else str(self.pixel_phase))
        more += "" if self.lamp_azimuth is None else f", lamp_azimuth={self.lamp_azimuth}"
        lamp = f"lamp_radius={self.lamp.radius!s}" if isinstance(self.lamp, DistantLamp) else f"lamp={self.lamp!r}"
        return f"Rig({self.camera!r}, {self.sample!r}, {lamp}{more})"


def _checked_phase(phase: PixelPhase, cell_value: CellValue) -> PixelPhase:
    if cell_value in ("centre", "edge", UNKNOWN):
        raise ArgumentError(f"pixel_phase requires cell_value 'nearest', 'bilinear' or 'mean', got '{cell_value}'")
    found = np.asarray(checks.within("pixel_phase", phase, -0.5, 0.5, "px"))  # type: ignore[arg-type]
    if found.shape not in ((2,), (GRID_SHAPE[1], 2)):
        raise ArgumentError(
            f"pixel_phase must be (x, y), px, or {GRID_SHAPE[1]} such pairs, got an array of shape {found.shape}"
        )
    if found.ndim == 1:
        return float(found[0]), float(found[1])
    return tuple((float(x), float(y)) for x, y in found)


def picture_shape(name: str, shape: tuple[int, int]) -> tuple[int, int]:
    """Check the height and width of an image.

    Args:
        name: name of the argument, for the message.
        shape: (height, width), two whole numbers in [1, 65535], px.

    Raises:
        ArgumentError: `shape` is not such a pair.

    Example:
        >>> matcam.rigs.picture_shape("crop", (480, 640))
        (480, 640)
    """
    if (
        not isinstance(shape, tuple | list)
        or len(shape) != 2
        or not all(type(n) is int and 1 <= n < 2**16 for n in shape)
    ):
        raise ArgumentError(
            f"{name} must be (height, width), two whole numbers in [1, {2**16 - 1}] px, got {shape!r:.60}"
        )
    return shape[0], shape[1]


def merl() -> Rig:
    """Build the rig of the MERL database.

    The rig is that assumed by Holzschuch & Pacanowski (2017). It has a QImaging Retiga 1300 and a sphere that covers
    half the height of the image, with a limb of radius 256 px. Pixels have a fill factor of 100 %. The blur of the optics
    is Gaussian with a standard deviation of half a pixel, an assumption of that paper. The uncertainty of this value is
    100 %, so that a fit estimates the blur from the data, down to no blur. The rule by which the cells of the table were
    read from pixels is unpublished. A fit estimates the rule from each table.

    Returns:
        The rig. Replace its parts to describe another rig.

    Source:
        Holzschuch & Pacanowski (2017), section 4; docs/model.md 5.

    Example:
        >>> rig = matcam.rigs.merl()
        >>> float(rig.sample.radius), float(rig.camera.optics.sigma)
        (256.0, 0.5)
    """
    source = "Holzschuch & Pacanowski 2017, section 4; sigma_mtf = sigma_p is their guess"
    guess = Uncertainty.of({"optics.sigma_px": 0.5})
    camera = Camera(GaussianOptics(0.5), BoxPixel(0.5), uncertainty=guess, provenance=Provenance(source=source))
    return Rig(camera, Sphere(256.0), cell_value=UNKNOWN)
