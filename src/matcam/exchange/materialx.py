"""OpenPBR surfaces in MaterialX, fitted to a measured BRDF.

OpenPBR (Academy Software Foundation, version 1.1) has GGX facets with height-correlated masking. Its
`specular_roughness` is the square root of alpha, the scale of facet slopes (Walter et al. 2007). A metal and a
dielectric are fitted, and the better of the two is written. The `base_color` of a metal is the reflectance at normal
incidence in Schlick's formula. The `base_color` of a dielectric is the albedo of a Lambertian base under a clear
interface of refractive index `specular_ior`. A renderer reduces the base by the reflectance of the interface. The fit
adds base and interface without this reduction.

An OpenPBR surface cannot represent a measured table exactly. The residual is part of the report and of the file.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.optimize import least_squares

from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.grid import CHANNELS
from matcam.core.io import write_text
from matcam.core.jax import jax, jnp
from matcam.exchange.parameterisation import check_isotropic
from matcam.material.material import Material
from matcam.material.microfacet import Microfacet
from matcam.material.ndf.ggx import GGX
from matcam.material.reflectance import Dielectric, Schlick

_LIMITS = {"alpha": (1e-3, 1.0), "colour": (1e-4, 1.0), "ior": (1.05, 3.0)}


class OpenPBRSurface(NamedTuple):
    """OpenPBR surface.

    Attributes:
        metalness: 1 for a metal, 0 for a dielectric, no unit.
        base_color: reflectance of a metal at normal incidence, or albedo of the base of a dielectric; linear RGB, no
            unit.
        specular_roughness: square root of alpha, the scale of facet slopes, no unit.
        specular_ior: refractive index of a dielectric, no unit; it has no effect for a metal.
        material: the same surface as a material that can be evaluated.

    Example:
        >>> surface = matcam.exchange.fit_openpbr(matcam.Microfacet(matcam.GGX(0.09), matcam.Schlick(0.9)))
        >>> surface.metalness, round(surface.specular_roughness, 2)
        (1.0, 0.3)
    """

    metalness: float
    base_color: tuple[float, float, float]
    specular_roughness: float
    specular_ior: float
    material: Microfacet


def fit_openpbr(material: Material) -> OpenPBRSurface:
    """Fit an OpenPBR surface to a material.

    A metal and a dielectric are fitted, and the better fit is returned. The fit minimises squared differences between
    cube roots of the BRDF times cos theta_i cos theta_o. The cube root balances highlight and tail.

    Args:
        material: isotropic material with one or three channels, such as `Tabulated(table)`.

    Raises:
        ArgumentError: the material is not a Material, is anisotropic, or has neither one nor three channels.

    Source:
        OpenPBR Surface specification 1.1; Bieron and Peers (2020), *An Adaptive BRDF Fitting Metric*: roots as a
        metric.

    Example:
        >>> matte = matcam.Microfacet(matcam.GGX(0.3), matcam.Dielectric(1.5), diffuse=[0.2, 0.3, 0.4])
        >>> surface = matcam.exchange.fit_openpbr(matte)
        >>> surface.metalness, round(surface.specular_ior, 2)
        (0.0, 1.5)
    """
    check_isotropic(material)
    # the half angles are dense about the peak, as in a MERL table
    theta_h, theta_d, phi_d = np.meshgrid(
        np.linspace(0.0, 1.0, 28) ** 2 * np.radians(85),
        np.radians(np.arange(5.0, 76, 10)),
        np.radians([0.0, 45.0, 90.0]),
        indexing="ij",
    )
    mean, half = np.cos(theta_h) * np.cos(theta_d), np.sin(theta_h) * np.sin(theta_d) * np.cos(phi_d)
    above = np.minimum(mean - half, mean + half) > 0.02
    theta_h, theta_d, phi_d = theta_h[above], theta_d[above], phi_d[above]
    cosines = (mean[above] ** 2 - half[above] ** 2)[:, None]
    seen = np.asarray(material.brdf(theta_h, theta_d, phi_d))
    seen = seen[:, None] if seen.ndim == 1 else seen
    if seen.shape[1] not in (1, len(CHANNELS)):
        raise ArgumentError(f"material must have 1 or {len(CHANNELS)} channels, got {seen.shape[1]}")
    seen = np.broadcast_to(seen, (len(seen), len(CHANNELS)))
    known = np.isfinite(seen)
    target = np.cbrt(np.where(known, np.maximum(seen, 0.0) * cosines, 0.0))

    def residuals_of(build: Any) -> Any:
        @jax.jit
        def roots(x: jax.Array) -> jax.Array:
            values = build(x).brdf(theta_h, theta_d, phi_d)
            return jnp.cbrt(jnp.maximum(values, 1e-300) * cosines)

        return lambda x: (np.where(known, np.asarray(roots(x)) - target, 0.0)).ravel()

    best = None
    for build, free, low, high in (
        (_metal, [0.5] * 3, [_LIMITS["colour"][0]] * 3, [_LIMITS["colour"][1]] * 3),
        (_dielectric, [1.5, *[0.3] * 3], [_LIMITS["ior"][0], *[0.0] * 3], [_LIMITS["ior"][1], *[1.0] * 3]),
    ):
        residuals = residuals_of(build)
        # the residual has several minima for narrow lobes, so the fit starts from several alphas
        for alpha in (0.003, 0.02, 0.1, 0.4):
            bounds = ([np.log(_LIMITS["alpha"][0]), *low], [np.log(_LIMITS["alpha"][1]), *high])
            found = least_squares(residuals, [np.log(alpha), *free], bounds=bounds, x_scale=[0.3, *[0.1] * len(free)])
            if best is None or found.cost < best[0].cost * (1 - 1e-9):
                best = (found, build)
    assert best is not None
    x, build = best[0].x, best[1]
    metal = build is _metal
    colour = tuple(float(one) for one in x[-3:])
    return OpenPBRSurface(float(metal), colour, float(np.exp(x[0] / 2)), 1.5 if metal else float(x[1]), build(x))  # type: ignore[arg-type]


def write_openpbr(path: str | Path, surface: OpenPBRSurface, *, note: str = "", force: bool = False) -> None:
    """Write an OpenPBR surface as a MaterialX document (.mtlx).

    Args:
        path: file to write.
        surface: surface from `fit_openpbr`.
        note: text for the document, such as the residual of the fit. Default: "".
        force: True to replace an existing file. Default: False.

    Raises:
        ArgumentError: `surface` or `note` is of the wrong type.
        OutputError: the file cannot be written, or exists and `force` is False.

    Example:
        >>> import pathlib, tempfile
        >>> surface = matcam.exchange.fit_openpbr(matcam.Microfacet(matcam.GGX(0.09), matcam.Schlick(0.9)))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "a.mtlx")
        ...     matcam.exchange.write_openpbr(path, surface)
        ...     "specular_roughness" in path.read_text()
        True
    """
    surface, note = checks.instance("surface", surface, OpenPBRSurface), checks.instance("note", note, str)
    colour = ", ".join(f"{one:.7g}" for one in surface.base_color)
    inputs = [("base_color", "color3", colour), ("base_metalness", "float", f"{surface.metalness:g}")]
    inputs += [("specular_roughness", "float", f"{surface.specular_roughness:.7g}")]
    inputs += [] if surface.metalness else [("specular_ior", "float", f"{surface.specular_ior:.7g}")]
    about = "specular_roughness is the square root of alpha, the scale of facet slopes (Walter et al. 2007). "
    lines = [
        '<?xml version="1.0"?>',
        '<materialx version="1.39" colorspace="lin_rec709">',
        f'  <open_pbr_surface name="surface" type="surfaceshader" doc={quoteattr(about + note)}>',
        *(f'    <input name="{name}" type="{kind}" value="{value}" />' for name, kind, value in inputs),
        "  </open_pbr_surface>",
        '  <surfacematerial name="material" type="material">',
        '    <input name="surfaceshader" type="surfaceshader" nodename="surface" />',
        "  </surfacematerial>",
        "</materialx>",
    ]
    write_text(path, "\n".join(lines) + "\n", force=force)


def _metal(x: Any) -> Microfacet:
    return Microfacet(GGX(jnp.exp(x[0])), Schlick(x[1:4]))


def _dielectric(x: Any) -> Microfacet:
    return Microfacet(GGX(jnp.exp(x[0])), Dielectric(x[1]), diffuse=x[2:5])
