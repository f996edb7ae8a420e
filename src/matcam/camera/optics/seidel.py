"""Lens that varies over the field: Zernike terms that depend on the distance from the optical axis (Seidel aberrations)."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

from matcam.camera.optics.optics import Optics
from matcam.camera.optics.pupil import DiffractionOptics
from matcam.camera.optics.varying import VaryingOptics
from matcam.camera.optics.zernike import ZernikeOptics, check_phase
from matcam.core import checks
from matcam.core.arrays import xp
from matcam.core.arrays.module import replaced

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import jax


class SeidelOptics(VaryingOptics):
    """Lens with aberrations that grow with the distance from the axis.

    At a distance of h times `unit` from the optical axis, the coefficients of the Zernike terms are: coma h `coma`,
    astigmatism h^2 `astigmatism`, defocus `defocus` + h^2 `curvature`, and spherical aberration `spherical`. Coma and
    astigmatism are oriented along the line to the axis.

    `at` evaluates the lens at one position. `picture` and `measure` support this lens: the image of each surface element is
    blurred by the lens at the position of that image.

    Args:
        f_number: working f-number, no unit, positive.
        wavelength: wavelength of the light, m, 1e-9 to 1e-3.
        pixel_pitch: distance between neighbouring pixels, m, 1e-8 to 1e-2.
        unit: distance from the optical axis at which the coefficients apply, px, positive, such as half the diagonal of
            the image.
        defocus: defocus on the axis, waves rms, as in `ZernikeOptics`. Default: 0.
        astigmatism: astigmatism at `unit`, waves rms; positive along the line to the axis. Default: 0.
        coma: coma at `unit`, waves rms. It is positive if the centroid of the image of a point is nearer to the axis than
            the sharpest part of that image. Default: 0.
        curvature: difference between the defocus at `unit` and on the axis, waves rms. Default: 0.
        spherical: spherical aberration, waves rms. Default: 0.

    Raises:
        ArgumentError: a parameter is out of range or not finite, coefficients seem to be in metres, or the aberrations are
            too large for `ZernikeOptics`.

    Source:
        Born & Wolf, Principles of Optics, 5.3, with Zernike terms (9.2).

    Example:
        >>> lens = matcam.SeidelOptics(8.0, 550e-9, 5e-6, unit=400.0, coma=0.2)
        >>> lens.at(200.0, 0.0).coma.tolist()
        [0.1, 0.0]
    """

    axial: ZernikeOptics
    unit: jax.Array
    astigmatism: jax.Array
    coma: jax.Array
    curvature: jax.Array

    profile_fields = MappingProxyType(
        {
            "f_number": "axial.focused.f_number",
            "wavelength_m": "axial.focused.wavelength",
            "pixel_pitch_m": "axial.focused.pixel_pitch",
            "unit_px": "unit",
            "defocus_waves": "axial.defocus",
            "astigmatism_waves": "astigmatism",
            "coma_waves": "coma",
            "curvature_waves": "curvature",
            "spherical_waves": "axial.spherical",
        }
    )

    def __init__(
        self,
        f_number: ArrayLike,
        wavelength: ArrayLike,
        pixel_pitch: ArrayLike,
        unit: ArrayLike,
        defocus: ArrayLike = 0.0,
        astigmatism: ArrayLike = 0.0,
        coma: ArrayLike = 0.0,
        curvature: ArrayLike = 0.0,
        spherical: ArrayLike = 0.0,
    ):
        self.axial = ZernikeOptics(f_number, wavelength, pixel_pitch, defocus=defocus, spherical=spherical)
        self.unit = checks.scalar("unit", checks.positive("unit", unit, "px"))
        parts = (("astigmatism", astigmatism), ("coma", coma), ("curvature", curvature))
        values = [checks.scalar(name, checks.number(name, value)) for name, value in parts]
        self.astigmatism, self.coma, self.curvature = values
        # the lens at the unit distance is checked, too
        ZernikeOptics(
            f_number, wavelength, pixel_pitch, curvature, (astigmatism, 0.0), (coma, 0.0), spherical=spherical
        )

    @property
    def focused(self) -> DiffractionOptics:
        """Diffraction-limited lens with the pupil of this lens."""
        return self.axial.focused

    def at(self, x: ArrayLike, y: ArrayLike) -> ZernikeOptics:
        """Evaluate the lens at a position.

        Args:
            x: position to the right of the optical axis, px.
            y: position above the optical axis, px.

        Raises:
            ArgumentError: the aberrations are too large at this position, or x or y is not a single finite number.
        """
        terms = checks.broadcastable(x=x, y=y)
        found = self.terms_at(*(checks.scalar(name, one) for name, one in zip("xy", terms, strict=True)))
        check_phase(found)
        lens = replaced(self.axial, "defocus", found[0])
        return replaced(replaced(lens, "astigmatism", found[1:3]), "coma", found[3:5])

    @property
    def named_lenses(self) -> dict[str, Optics]:
        """Lens on the optical axis, with the key "centre"."""
        return {"centre": self.at(0.0, 0.0)}

    def terms_at(self, x: ArrayLike, y: ArrayLike) -> jax.Array:
        """Compute the coefficients of the Zernike terms at positions, waves rms.

        The result has the shape (..., 8); the terms are in the order of `ZernikeOptics.terms`.

        Args:
            x: positions to the right of the optical axis, px; broadcasts with y.
            y: positions above the optical axis, px.
        """
        right, up = (xp.asarray(a) / self.unit for a in (x, y))
        defocus = self.axial.defocus + self.curvature * (right**2 + up**2)
        astigmatism = self.astigmatism * (right**2 - up**2), self.astigmatism * 2 * right * up
        coma = self.coma * right, self.coma * up
        none = xp.zeros(())
        return xp.stack(
            xp.broadcast_arrays(defocus, *astigmatism, *coma, none, none, self.axial.spherical + 0 * right), -1
        )

    def band(self) -> float:
        """Compute the cutoff, cycles/px."""
        return self.axial.band()

    def instead(self) -> str:
        """Describe how to select a single lens, for an error message."""
        return "use Camera(optics.at(x, y), pixel)"
