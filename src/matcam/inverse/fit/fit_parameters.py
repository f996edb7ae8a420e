"""Free parameters of a fit: names, bounds and coordinates.

Most coordinates of a fit are logarithms: of the parameters of a lobe, of the refractive index n and the extinction
coefficient k of a conductor, and of eta - 1 for a dielectric of refractive index eta. A step of such a coordinate is a
relative change. `Layout` defines the order of the coordinates of all lobes, of the rig and of the units in one vector. A
unit is one channel of one table.
"""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import NamedTuple

import numpy as np

from matcam.core.jax import jax, jnp
from matcam.core.registry import FAMILIES, FRESNEL_MODELS, WITH_POWER
from matcam.material.masking import Masking
from matcam.material.ndf.distribution import NDF, SlopeDistribution
from matcam.material.ndf.free_lobe import ShadowedNDF, SplineNDF
from matcam.material.ndf.ggx import AnisotropicGGX
from matcam.material.ndf.student_lobe import StudentLobe
from matcam.material.ndf.two_lobes import TwoLobes
from matcam.material.reflectance import Conductor, Dielectric, Reflectance, Schlick

FresnelModel = str
"""Name of a Fresnel term, one of `FRESNEL_MODELS`."""

NARROWEST_PX = 0.02
"""Smallest width of a lobe on the sensor, px. Every camera records a narrower lobe as a point."""

STUDENT, TWO_LOBES = StudentLobe.family, TwoLobes.family
"""Families that `correct` fits if the public families do not explain the data. They cannot be selected by an option."""
_UNNAMED: dict[str, type[StudentLobe | TwoLobes]] = {STUDENT: StudentLobe, TWO_LOBES: TwoLobes}
_EXCESS_BOUNDS = (-0.6, 3.7)
"""Bounds of ln(g - 1) for the exponent g of Student's t. Masking is finite from g = 3/2; the upper bound has the tails of
Beckmann's lobe.
"""
_SHARE_BOUNDS = (-6.0, 6.0)
"""Bounds of ln(share / (1 - share)) for the share of the second of two lobes. At the bounds the share of one lobe is 0.25 %,
which is not detectable in an image.
"""

_POWER_BOUNDS = {"epd": (0.25, 4.0), "sgd": (0.02, 2.0)}
_SPLINE_BOUNDS = (-25.0, 25.0)
_FRESNEL_NAMES: dict[str, tuple[str, ...]] = {
    name: () if name == "free" else tuple(field.name for field in dataclasses.fields(term))
    for name, term in FRESNEL_MODELS.items()
}
FRESNEL_LATTICE: dict[str, list[tuple[float, ...]]] = {
    "conductor": [
        (float(np.log(n)), float(np.log(k)))
        for n in (0.15, 0.3, 0.6, 1.0, 1.6, 2.5, 4.0)
        for k in (0.05, 0.5, 1.5, 2.5, 3.5, 5.0, 7.0)
    ],
    "schlick": [(f0,) for f0 in np.linspace(0.01, 0.99, 40)],
    "dielectric": [(float(np.log(eta - 1)),) for eta in np.linspace(1.02, 3.5, 40)],
}
"""Coordinates of each Fresnel model from which the starting point of a fit is chosen."""
_FRESNEL_BOUNDS = {"n": (-5.0, 4.0), "k": (-7.0, 4.0), "f0": (1e-4, 1.0), "eta": (-6.0, 3.0)}
BASE_WIDTH, COATED = "base_alpha", "coated_share"
"""Names of the parameters for the roughness of a base, and for the share of the diffuse part that is under a coat."""


class LobeKind(NamedTuple):
    """Parametrisation of a lobe: family, masking and spline modification.

    Attributes:
        family: key of `FAMILIES`, STUDENT or TWO_LOBES.
        masking: name of the masking G of the lobe, or None.
        spline_size: number of coefficients of the spline modification; 0 or KNOTS.
        shadows: number of parameters of a free masking; 0 or SHADOWS.
        stretched: True for a "ggx" lobe with different roughnesses along the tangents x and y of the surface.
    """

    family: str
    masking: Masking
    spline_size: int = 0
    shadows: int = 0
    stretched: bool = False

    @property
    def family_names(self) -> tuple[str, ...]:
        """Names of the parameters of the family, as in its constructor; "alpha_x" and "alpha_y" for an anisotropic lobe."""
        if self.family in _UNNAMED:
            return tuple(field.name for field in dataclasses.fields(_UNNAMED[self.family]))
        return ("alpha_x", "alpha_y") if self.stretched else _fields_of(self.family)

    @property
    def of_family(self) -> bool:
        """True if the parameters of a family describe the lobe."""
        return not (self.spline_size or self.shadows or self.family in _UNNAMED)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all coordinates of the lobe, in the order family, spline and free masking.

        `lobe_readings` computes the parameters that are reported instead.
        """
        splines = (f"spline{k}" for k in range(self.spline_size))
        return (*self.family_names, *splines, *(f"shadow{k}" for k in range(self.shadows)))

    @property
    def size(self) -> int:
        return len(self.family_names) + self.spline_size + self.shadows

    def ndf(self, q: jax.Array) -> NDF:
        """Build the NDF from coordinates.

        q: coordinates in the order of `names`. The coordinates of a family are the logarithms of its parameters. The family
            TWO_LOBES is an exception: the share of the second lobe is the logistic function of its coordinate, and the
            shares of Beckmann are coordinates themselves. The coefficients of spline and free masking are also coordinates
            themselves.
        """
        own = len(self.family_names)
        if self.family == TWO_LOBES:
            ndf: NDF = TwoLobes(jnp.exp(q[0]), jnp.exp(q[1]), jax.nn.sigmoid(q[2]), q[3], q[4])
        elif self.family == STUDENT:
            ndf = StudentLobe(jnp.exp(q[0]), jnp.exp(q[1]))
        else:
            ndf = FAMILIES[self.family](*(jnp.exp(one) for one in q[:own]))
        coefficients, shadows = q[own : own + self.spline_size], q[own + self.spline_size : self.size]
        if self.spline_size:
            ndf = SplineNDF(ndf, coefficients)
        return ShadowedNDF(ndf, shadows) if self.shadows else ndf

    def slopes(self, q: jax.Array) -> SlopeDistribution:
        return AnisotropicGGX(jnp.exp(q[0]), jnp.exp(q[1])) if self.stretched else self.ndf(q)

    def bounds(self, radius: float) -> list[tuple[float, float]]:
        """Compute the lower and the upper bound of each coordinate.

        radius: radius of the sphere, px.
        """
        largest = 1.0 if self.family in _UNNAMED else FAMILIES[self.family].largest
        bounds = [(float(np.log(NARROWEST_PX / radius)), float(np.log(0.999 * largest)))]
        bounds *= 1 + (self.stretched or self.family == TWO_LOBES)
        if self.family == TWO_LOBES:
            bounds += [_SHARE_BOUNDS, (0.0, 1.0), (0.0, 1.0)]
        if self.family == STUDENT:
            bounds.append(_EXCESS_BOUNDS)
        if self.family in WITH_POWER:
            low, high = _POWER_BOUNDS[self.family]
            bounds.append((float(np.log(low)), float(np.log(high))))
        return bounds + [_SPLINE_BOUNDS] * (self.spline_size + self.shadows)


@cache
def _fields_of(family: str) -> tuple[str, ...]:
    return tuple(field.name for field in dataclasses.fields(FAMILIES[family]))


class Layout(NamedTuple):
    """Order of the coordinates of a fit in one vector.

    The order is: lobes, rig, coated share of the diffuse part, roughness of a base, then the Fresnel term and the body of each
    unit (a channel of a table).

    Attributes:
        kind: parametrisation of each lobe.
        fresnel: model of the Fresnel term F, a key of `FRESNEL_MODELS`.
        diffuse: True if each unit has a diffuse part.
        lobe_of: index of the lobe of each unit, (units,).
        axes: number of fitted parameters of the rig.
        base: True if the material has a rough base under the lobe (`body.py`), whose reflectance differs between units.
        coated: True if a fitted share of the diffuse part is under a coat (`body.py`).
    """

    kind: LobeKind
    fresnel: FresnelModel
    diffuse: bool
    lobe_of: tuple[int, ...]
    axes: int
    base: bool = False
    coated: bool = False

    @property
    def lobes(self) -> int:
        return max(self.lobe_of) + 1

    @property
    def units(self) -> int:
        return len(self.lobe_of)

    @property
    def fresnel_size(self) -> int:
        return len(_FRESNEL_NAMES[self.fresnel])

    @property
    def unit_names(self) -> tuple[str, ...]:
        body = ["diffuse"] * self.diffuse + ["base"] * self.base
        return (*_FRESNEL_NAMES[self.fresnel], *body)

    @property
    def size(self) -> int:
        return self.base_width.stop + self.units * len(self.unit_names)

    def lobe(self, index: int) -> slice:
        return slice(index * self.kind.size, (index + 1) * self.kind.size)

    @property
    def rig(self) -> slice:
        first = self.lobes * self.kind.size
        return slice(first, first + self.axes)

    @property
    def coat(self) -> slice:
        """Slice of the vector that contains the coated share - 1/2; it is empty if the share is not fitted."""
        return slice(self.rig.stop, self.rig.stop + self.coated)

    def coated_share(self, p: np.ndarray) -> float:
        return readable_value(COATED, float(p[self.coat.start]))[0] if self.coated else 0.0

    @property
    def base_width(self) -> slice:
        """Slice of the vector that contains ln(roughness of the base); it is empty without a base."""
        return slice(self.coat.stop, self.coat.stop + self.base)

    def unit(self, index: int) -> slice:
        size = len(self.unit_names)
        first = self.base_width.stop + index * size
        return slice(first, first + size)

    def of_units(self, name: str) -> list[int]:
        if name not in self.unit_names:
            return []
        return [self.unit(u).start + self.unit_names.index(name) for u in range(self.units)]

    def unit_bounds(self) -> list[tuple[float, float]]:
        bounds = [_FRESNEL_BOUNDS[name] for name in _FRESNEL_NAMES[self.fresnel]]
        return bounds + [(0.0, 1.0)] * (self.diffuse + self.base)


def reflectance_at(model: FresnelModel, coordinates: jax.Array) -> Reflectance:
    """Build the Fresnel term from coordinates.

    coordinates: (ln n, ln k) of a conductor, (f0,) of Schlick's model, or (ln(eta - 1),) of a dielectric.
    """
    if model == "conductor":
        return Conductor(jnp.exp(coordinates[0]), jnp.exp(coordinates[1]))
    if model == "schlick":
        return Schlick(coordinates[0])
    return Dielectric(1 + jnp.exp(coordinates[0]))


def readable_value(name: str, coordinate: float) -> tuple[float, float]:
    """Compute the reported value of a parameter, and its derivative with respect to the coordinate.

    name: name of the parameter, such as "alpha", "eta" or COATED.
    """
    if name in ("f0", "diffuse", "base"):
        return coordinate, 1.0
    if name == COATED:
        return coordinate + 0.5, 1.0
    value = float(np.exp(coordinate))
    return (1 + value, value) if name == "eta" else (value, value)


def fresnel_start(model: FresnelModel, theta: np.ndarray, f: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Find the coordinates of a Fresnel term F that best fit a curve of F.

    The coordinates are those of `FRESNEL_LATTICE` with the smallest weighted sum of squared differences.

    Args:
        model: model of F, a key of `FRESNEL_LATTICE`.
        theta: angles, rad, (slices,).
        f: F at the angles, (slices,).
        weight: weights of the squared differences, (slices,).
    """
    points = FRESNEL_LATTICE[model]
    curves = [np.asarray(reflectance_at(model, jnp.asarray(p)).at(jnp.asarray(theta))) for p in points]
    misfit = [(weight * (f - curve) ** 2).sum() for curve in curves]
    return np.array(points[int(np.argmin(misfit))])
