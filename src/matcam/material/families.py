"""Families of isotropic NDFs, by the name that users give."""

from __future__ import annotations

from matcam.material.gaussian_lobe import GaussianNDF
from matcam.material.ggx import GGX
from matcam.material.ndf import NDF, MixtureNDF

ONE_WIDTH: dict[str, type[MixtureNDF]] = {cls.family: cls for cls in (GaussianNDF, GGX)}
"""Those of one roughness and nothing else, which a camera's blur of has a closed form: what `fresnel` can fit."""

FAMILIES: dict[str, type[NDF]] = {**ONE_WIDTH}
"""All of them. The constructor's first argument is the roughness; a second one, where there is one, the power."""
