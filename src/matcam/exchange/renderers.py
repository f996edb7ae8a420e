"""Microfacet materials in the words of renderers: Mitsuba 3 (a dict) and pbrt-v4 (text).

What "roughness" means is where such exports go wrong. Here it is alpha, the scale of facet SLOPES, as in Walter et al. 2007:
Mitsuba's `alpha` is that number; pbrt's `roughness` is that number only with `remaproughness false` (by default pbrt takes
alpha = sqrt(roughness)). Disney's roughness would be sqrt(alpha). What stays different: Mitsuba masks separably, G1 G1, as
`masking="smith-separable"`; pbrt masks with height correlation, as "smith". What a renderer's model does not have is refused:
`adaptive_grid` makes a file of any material.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from matcam.errors import ArgumentError
from matcam.material.anisotropic import AnisotropicBeckmann, AnisotropicGGX
from matcam.material.beckmann import Beckmann
from matcam.material.ggx import GGX
from matcam.material.microfacet import Microfacet
from matcam.material.reflectance import Conductor, Constant
from matcam.table import CHANNEL_WAVELENGTHS, CHANNELS

_ELSE = "convert it to a .bsdf file instead"


def mitsuba_material(material: Microfacet) -> dict[str, Any]:
    """Dict for `mitsuba.load_dict`, for RGB variants: GGX or Beckmann facets, isotropic or not, of a metal (`Conductor`) or a
    constant reflectance, with a diffuse part.

    Exact for `masking="smith-separable"` but for Mitsuba's rational approximation of Beckmann's masking (0.35 %); any other
    masking is replaced by that. The diffuse part is added by a `blendbsdf`, whose shares are divided out again.
    """
    _check(material)
    kind = "ggx" if isinstance(material.ndf, GGX | AnisotropicGGX) else "beckmann"
    if not isinstance(material.ndf, GGX | AnisotropicGGX | Beckmann | AnisotropicBeckmann):
        raise ArgumentError(f"Mitsuba has GGX and Beckmann facets, not {material.ndf!r}: {_ELSE}")
    along, across = _alphas(material)
    facets: dict[str, Any] = {"type": "roughconductor", "distribution": kind, "alpha_u": along, "alpha_v": across}
    albedo = _rgb(material.diffuse)
    share = float(albedo.max())
    if share >= 1:
        raise ArgumentError("a diffuse albedo of 1 leaves no share for the highlight in Mitsuba's blendbsdf")
    if isinstance(material.fresnel, Conductor):
        facets |= {"eta": _colour(_rgb(material.fresnel.n)), "k": _colour(_rgb(material.fresnel.k))}
        facets |= {"specular_reflectance": 1 / (1 - share)} if share else {}
    elif isinstance(material.fresnel, Constant):
        scaled = _rgb(material.fresnel.value) / (1 - share)
        grey = bool(np.all(scaled == scaled[0]))
        if not grey and scaled.max() > 1:
            raise ArgumentError(f"a coloured reflectance and a diffuse albedo above 1 together: {_ELSE}")
        facets |= {"material": "none", "specular_reflectance": float(scaled[0]) if grey else _colour(scaled)}
    else:
        raise ArgumentError(f"Mitsuba's rough conductor has no {type(material.fresnel).__name__} term: {_ELSE}")
    if not share:
        return facets
    lambert = {"type": "diffuse", "reflectance": _colour(albedo / share)}
    return {"type": "blendbsdf", "weight": share, "facets": facets, "lambert": lambert}


def pbrt_material(material: Microfacet, name: str | None = None) -> str:
    """Text for a pbrt-v4 scene: `Material "conductor" ...`, or a named material. GGX facets, isotropic or not, of a metal,
    nothing diffuse: that is what pbrt's conductor is. n and k stand at this package's wavelengths of R, G, B, in nm."""
    _check(material)
    if not isinstance(material.ndf, GGX | AnisotropicGGX):
        raise ArgumentError(f"pbrt has GGX facets, not {material.ndf!r}")
    if not isinstance(material.fresnel, Conductor) or np.any(np.asarray(material.diffuse) > 0):
        raise ArgumentError("pbrt's conductor is a metal without a diffuse part")
    if name is not None and (not name or any(c in name for c in '"\\\n')):
        raise ArgumentError(f"name must hold no quotes, backslashes or line breaks, got {name!r}")
    along, across = _alphas(material)
    order = np.argsort(CHANNEL_WAVELENGTHS)

    def spectrum(values: np.ndarray) -> str:
        return " ".join(f"{CHANNEL_WAVELENGTHS[k] * 1e9:.6g} {values[k]:.9g}" for k in order)

    head = 'Material "conductor"' if name is None else f'MakeNamedMaterial "{name}" "string type" "conductor"'
    return (
        f"# roughness is alpha, the scale of facet slopes (Walter et al. 2007): hence remaproughness false\n{head}\n"
        f'    "spectrum eta" [ {spectrum(_rgb(material.fresnel.n))} ]\n'
        f'    "spectrum k" [ {spectrum(_rgb(material.fresnel.k))} ]\n'
        f'    "float uroughness" {along:.9g} "float vroughness" {across:.9g} "bool remaproughness" false\n'
    )


def _check(material: Microfacet) -> None:
    if not isinstance(material, Microfacet):
        raise ArgumentError(
            f"material must be a Microfacet (a fit's .material), got {type(material).__name__}: {_ELSE}"
        )


def _alphas(material: Microfacet) -> tuple[float, float]:
    ndf = material.ndf
    if isinstance(ndf, GGX | Beckmann):
        return float(ndf.alpha), float(ndf.alpha)
    return float(ndf.alpha_along), float(ndf.alpha_across)  # type: ignore[attr-defined]


def _rgb(values: Any) -> np.ndarray:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim and array.size not in (1, len(CHANNELS)):
        raise ArgumentError(f"renderers take {len(CHANNELS)} channels, this material has {array.size}")
    return np.broadcast_to(array, len(CHANNELS)).copy()


def _colour(values: np.ndarray) -> dict[str, Any]:
    return {"type": "rgb", "value": values.tolist()}
