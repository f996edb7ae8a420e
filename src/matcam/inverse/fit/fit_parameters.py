"""Free parameters of a fit: names, bounds and coordinates.

The coordinates of a fit are logarithms of the parameters of a lobe, of n, of k and of eta - 1, so that a step has the
same meaning everywhere. `Layout` defines the order of all lobes, parameters of the rig and Fresnel terms in one vector.
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
"""Width of a lobe on the sensor, px, below which every camera records it as a point."""

STUDENT, TWO_LOBES = StudentLobe.family, TwoLobes.family
"""Lobes that `correct` tries if no family explains the data. They are not available as options."""
_UNNAMED: dict[str, type[StudentLobe | TwoLobes]] = {STUDENT: StudentLobe, TWO_LOBES: TwoLobes}
_EXCESS_BOUNDS = (-0.6, 3.7)
"""Bounds of ln(g - 1) of Student's t, from the limit of finite masking (g = 3/2) to Beckmann's tails."""
_SHARE_BOUNDS = (-6.0, 6.0)
"""Bounds of ln(share / (1 - share)). A share of 0.25 % is not detectable in an image."""

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
"""Coordinates of each model that are compared before a fit."""
_FRESNEL_BOUNDS = {"n": (-5.0, 4.0), "k": (-7.0, 4.0), "f0": (1e-4, 1.0), "eta": (-6.0, 3.0)}
BASE_WIDTH = "base_alpha"
"""Name of the roughness of a base."""


class LobeKind(NamedTuple):
    """Meaning of the parameters of a lobe: family, masking, and spline modifications.

    Attributes:
        family: key of `FAMILIES`, STUDENT or TWO_LOBES.
        masking: masking G of the lobe.
        spline_size: number of coefficients of the spline modification; 0 or KNOTS.
        shadows: number of parameters of a free masking; 0 or SHADOWS.
        stretched: True if a "ggx" lobe has one roughness along the first tangent of the surface and one across.
    """

    family: str
    masking: Masking
    spline_size: int = 0
    shadows: int = 0
    stretched: bool = False

    @property
    def family_names(self) -> tuple[str, ...]:
        """Names of the parameters of the family, as in its constructor; for a stretched lobe, by the tangents x and y."""
        if self.family in _UNNAMED:
            return tuple(field.name for field in dataclasses.fields(_UNNAMED[self.family]))
        return ("alpha_x", "alpha_y") if self.stretched else _fields_of(self.family)

    @property
    def of_family(self) -> bool:
        """True if the parameters of a family describe the lobe."""
        return not (self.spline_size or self.shadows or self.family in _UNNAMED)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all coordinates: family, spline, free masking. Reported parameters are those of `lobe_readings`."""
        splines = (f"spline{k}" for k in range(self.spline_size))
        return (*self.family_names, *splines, *(f"shadow{k}" for k in range(self.shadows)))

    @property
    def size(self) -> int:
        """Count the parameters."""
        return len(self.family_names) + self.spline_size + self.shadows

    def ndf(self, q: jax.Array) -> NDF:
        """Build the NDF at coordinates: logarithms of the parameters of the family, then spline coefficients.

        The share of the second of two lobes is the logistic function of its coordinate.
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
        """Return the distribution of slopes at coordinates, isotropic or stretched."""
        return AnisotropicGGX(jnp.exp(q[0]), jnp.exp(q[1])) if self.stretched else self.ndf(q)

    def bounds(self, radius: float) -> list[tuple[float, float]]:
        """Bound the coordinates for a lobe on a sphere of `radius` px."""
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
    """Order of the vector of a fit: lobes, the rig, the roughness of a base, then Fresnel term and body of each unit.

    Attributes:
        kind: meaning of the parameters of each lobe.
        fresnel: model of F.
        diffuse: True if each unit has a Lambertian part.
        lobe_of: index of the lobe of each unit (a channel of a table).
        axes: number of fitted parameters of the rig.
        base: True if the material has a rough base under the lobe (`base_lobe.py`), with a reflectance of each unit.
    """

    kind: LobeKind
    fresnel: FresnelModel
    diffuse: bool
    lobe_of: tuple[int, ...]
    axes: int
    base: bool = False

    @property
    def lobes(self) -> int:
        """Count the different lobes."""
        return max(self.lobe_of) + 1

    @property
    def units(self) -> int:
        """Count the units."""
        return len(self.lobe_of)

    @property
    def fresnel_size(self) -> int:
        """Count the parameters of a unit's Fresnel term."""
        return len(_FRESNEL_NAMES[self.fresnel])

    @property
    def unit_names(self) -> tuple[str, ...]:
        """Name the parameters of a unit."""
        body = ["diffuse"] * self.diffuse + ["base"] * self.base
        return (*_FRESNEL_NAMES[self.fresnel], *body)

    @property
    def size(self) -> int:
        """Count all parameters."""
        return self.base_width.stop + self.units * len(self.unit_names)

    def lobe(self, index: int) -> slice:
        """Return the indices of a lobe in the vector."""
        return slice(index * self.kind.size, (index + 1) * self.kind.size)

    @property
    def rig(self) -> slice:
        """Return the indices of the parameters of the rig in the vector."""
        first = self.lobes * self.kind.size
        return slice(first, first + self.axes)

    @property
    def base_width(self) -> slice:
        """Return the index of the logarithm of the roughness of a base; empty without a base."""
        return slice(self.rig.stop, self.rig.stop + self.base)

    def unit(self, index: int) -> slice:
        """Return the indices of a unit in the vector."""
        size = len(self.unit_names)
        first = self.base_width.stop + index * size
        return slice(first, first + size)

    def of_units(self, name: str) -> list[int]:
        """Return the index of a parameter of each unit in the vector; empty if the units do not have it."""
        if name not in self.unit_names:
            return []
        return [self.unit(u).start + self.unit_names.index(name) for u in range(self.units)]

    def unit_bounds(self) -> list[tuple[float, float]]:
        """Bound the coordinates of one unit."""
        bounds = [_FRESNEL_BOUNDS[name] for name in _FRESNEL_NAMES[self.fresnel]]
        return bounds + [(0.0, 1.0)] * (self.diffuse + self.base)


def reflectance_at(model: FresnelModel, coordinates: jax.Array) -> Reflectance:
    """Return the Fresnel term at coordinates (ln n, ln k), (f0,) or (ln(eta - 1),)."""
    if model == "conductor":
        return Conductor(jnp.exp(coordinates[0]), jnp.exp(coordinates[1]))
    if model == "schlick":
        return Schlick(coordinates[0])
    return Dielectric(1 + jnp.exp(coordinates[0]))


def readable_value(name: str, coordinate: float) -> tuple[float, float]:
    """Convert a coordinate to the reported parameter, and compute its derivative with respect to the coordinate."""
    if name in ("f0", "diffuse", "base"):
        return coordinate, 1.0
    value = float(np.exp(coordinate))
    return (1 + value, value) if name == "eta" else (value, value)


def fresnel_start(model: FresnelModel, theta: np.ndarray, f: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Find coordinates close to a curve F(theta): the best of a lattice. f, weight: (slices,)."""
    points = FRESNEL_LATTICE[model]
    curves = [np.asarray(reflectance_at(model, jnp.asarray(p)).at(jnp.asarray(theta))) for p in points]
    misfit = [(weight * (f - curve) ** 2).sum() for curve in curves]
    return np.array(points[int(np.argmin(misfit))])
