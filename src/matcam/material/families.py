"""Families of isotropic NDFs, by the name that users give."""

from __future__ import annotations

from matcam.material.beckmann import Beckmann
from matcam.material.epd import EPD
from matcam.material.gaussian_lobe import GaussianNDF
from matcam.material.ggx import GGX
from matcam.material.ndf import NDF, MixtureNDF
from matcam.material.sgd import SGD

ONE_WIDTH: dict[str, type[MixtureNDF]] = {cls.family: cls for cls in (GaussianNDF, GGX, Beckmann)}
"""Those of one roughness and nothing else, whose record by a camera has a closed form: what `fresnel` can fit."""

WITH_POWER: dict[str, type[NDF]] = {cls.family: cls for cls in (EPD, SGD)}
"""Those of a roughness and a power."""

FAMILIES: dict[str, type[NDF]] = {**ONE_WIDTH, **WITH_POWER}
"""All of them. The constructor's first argument is the roughness, its second, where there is one, the power."""
