"""Materials for renderers: microfacet materials for Mitsuba 3 and pbrt-v4, and a sphere rendered by Mitsuba.

Conventions of "roughness" differ. In this package, roughness is alpha, the scale of facet slopes (Walter et al. 2007).

- Mitsuba's `alpha` is the same value. pbrt's `roughness` is the same value only with `remaproughness false`; by default pbrt
  uses alpha = sqrt(roughness). Disney's roughness is sqrt(alpha).
- Mitsuba uses separable masking, as `masking="smith-separable"` does. pbrt uses height-correlated masking, as "smith" does.
- Materials without a counterpart in the renderer raise ArgumentError; `adaptive_grid` converts any isotropic material.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.grid import CHANNEL_WAVELENGTHS, CHANNELS
from matcam.core.io import one_by_one
from matcam.exchange.parameterisation import adaptive_grid
from matcam.files.float_pictures import read_exr
from matcam.files.rgl import write_rgl
from matcam.material.material import Material
from matcam.material.microfacet import Microfacet
from matcam.material.ndf.beckmann import AnisotropicBeckmann, Beckmann
from matcam.material.ndf.ggx import GGX, AnisotropicGGX
from matcam.material.reflectance import Conductor, Constant

_ELSE = "write the material as a .bsdf file instead (adaptive_grid and write_rgl)"


def mitsuba_material(material: Microfacet) -> dict[str, Any]:
    """Convert a microfacet material to a dict for `mitsuba.load_dict`.

    The dict is for RGB variants of Mitsuba. The conversion is exact for `masking="smith-separable"`, except for the
    rational approximation of Beckmann's masking in Mitsuba (0.35 %). Any other masking is replaced by separable
    masking. A `blendbsdf` adds the diffuse part. Its weights are compensated by larger reflectances.

    Args:
        material: GGX or Beckmann facets, isotropic or not, of a metal (`Conductor`) or a constant reflectance, with a
            diffuse albedo below 1, such as the `.material` of a fit.

    Returns:
        The dict.

    Raises:
        ArgumentError: Mitsuba has no equivalent material.

    Source:
        Walter et al. (2007): alpha. Mitsuba 3, plugins `roughconductor` and `blendbsdf`.

    Example:
        >>> gold = matcam.Microfacet(matcam.GGX(0.1), matcam.Conductor(0.2, 3.0))
        >>> facets = matcam.exchange.mitsuba_material(gold)
        >>> facets["type"], facets["distribution"], facets["alpha_u"]
        ('roughconductor', 'ggx', 0.1)
    """
    _check(material)
    kind = "ggx" if isinstance(material.ndf, GGX | AnisotropicGGX) else "beckmann"
    if not isinstance(material.ndf, GGX | AnisotropicGGX | Beckmann | AnisotropicBeckmann):
        raise ArgumentError(f"Mitsuba supports GGX and Beckmann facets, not {material.ndf!r}: {_ELSE}")
    along, across = _alphas(material)
    facets: dict[str, Any] = {"type": "roughconductor", "distribution": kind, "alpha_u": along, "alpha_v": across}
    albedo = _rgb(material.diffuse)
    share = float(albedo.max())
    if share >= 1:
        raise ArgumentError(
            "a diffuse albedo of 1 leaves no share for the highlight in Mitsuba's blendbsdf: give an albedo below 1"
        )
    if isinstance(material.fresnel, Conductor):
        facets |= {"eta": _colour(_rgb(material.fresnel.n)), "k": _colour(_rgb(material.fresnel.k))}
        facets |= {"specular_reflectance": 1 / (1 - share)} if share else {}
    elif isinstance(material.fresnel, Constant):
        scaled = _rgb(material.fresnel.value) / (1 - share)
        grey = bool(np.all(scaled == scaled[0]))
        if not grey and scaled.max() > 1:
            raise ArgumentError(
                f"the sum of a coloured reflectance and the diffuse albedo must not exceed 1 in Mitsuba: {_ELSE}"
            )
        facets |= {"material": "none", "specular_reflectance": float(scaled[0]) if grey else _colour(scaled)}
    else:
        raise ArgumentError(
            f"Mitsuba's rough conductor does not support {type(material.fresnel).__name__} as the Fresnel term: {_ELSE}"
        )
    if not share:
        return facets
    lambert = {"type": "diffuse", "reflectance": _colour(albedo / share)}
    return {"type": "blendbsdf", "weight": share, "facets": facets, "lambert": lambert}


def pbrt_material(material: Microfacet, name: str | None = None) -> str:
    """Convert a microfacet material to text for a pbrt-v4 scene.

    The refractive index and the extinction coefficient of the metal are given at the wavelengths of R, G and B of this
    package, nm.

    Args:
        material: GGX facets, isotropic or not, of a metal (`Conductor`) without a diffuse part.
        name: name of the material in the scene. Default: None, a `Material "conductor"` for the shapes that follow.

    Returns:
        The text.

    Raises:
        ArgumentError: pbrt's conductor does not support the material, or the name is empty or contains quotes,
            backslashes or line breaks.

    Source:
        Walter et al. (2007): alpha. pbrt-v4, material `conductor`.

    Example:
        >>> gold = matcam.Microfacet(matcam.GGX(0.1), matcam.Conductor(0.2, 3.0))
        >>> print(matcam.exchange.pbrt_material(gold, name="gold").splitlines()[1])
        MakeNamedMaterial "gold" "string type" "conductor"
    """
    _check(material)
    if not isinstance(material.ndf, GGX | AnisotropicGGX):
        raise ArgumentError(f"pbrt supports only GGX facets, not {material.ndf!r}: give GGX facets")
    if not isinstance(material.fresnel, Conductor) or np.any(np.asarray(material.diffuse) > 0):
        raise ArgumentError(
            "pbrt's conductor supports only metals without a diffuse part: give a Conductor as the Fresnel term, and diffuse=0"
        )
    if name is not None and (not name or any(c in name for c in '"\\\n')):
        raise ArgumentError(f"name must not be empty or contain quotes, backslashes or line breaks, got {name!r}")
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
            f"material must be a Microfacet such as the .material of a fit, got {type(material).__name__}: {_ELSE}"
        )


def _alphas(material: Microfacet) -> tuple[float, float]:
    ndf = material.ndf
    if isinstance(ndf, GGX | Beckmann):
        return float(ndf.alpha), float(ndf.alpha)
    return float(ndf.alpha_along), float(ndf.alpha_across)  # type: ignore[attr-defined]


def _rgb(values: Any) -> np.ndarray:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim and array.size not in (1, len(CHANNELS)):
        raise ArgumentError(f"a material for a renderer must have 1 or {len(CHANNELS)} channels, got {array.size}")
    return np.broadcast_to(array, len(CHANNELS)).copy()


def _colour(values: np.ndarray) -> dict[str, Any]:
    return {"type": "rgb", "value": values.tolist()}


def rendered_sphere(
    material: Material,
    *,
    lamp_angle: float = 0.7,
    environment: str | Path | None = None,
    size: int = 256,
    samples: int = 64,
) -> np.ndarray:
    """Render a sphere of a material with Mitsuba 3 (extra `matcam[render]`).

    The sphere fills the image. The camera is distant. The film stores float32 and has a box filter of one pixel,
    because the default filter of Mitsuba blurs by half a pixel. The material is converted by `adaptive_grid`.

    A distant lamp of irradiance pi is displaced towards +x, and upwards by a third of this displacement. The sky has a uniform
    radiance of 0.2. A white diffuse sphere has radiance 1 + 0.2 where it faces the lamp.

    Args:
        material: any isotropic material with one or three channels.
        lamp_angle: angle between lamp and camera in the horizontal plane, in (-pi, pi), rad. Default: 0.7.
        environment: OpenEXR file of three channels (latitudes by longitudes) that replaces lamp and sky. Default: None,
            lamp and sky.
        size: side of the image, in [16, 4096], px. Default: 256.
        samples: samples per pixel, in [1, 65536]. Default: 64; more reduce noise.

    Returns:
        Linear radiance, float32, (size, size, 3), without NaN; row 0 on top.

    Raises:
        ArgumentError: Mitsuba is not installed, the material is not supported, or an argument is out of its range.
        FileFormatError: the file of the environment is missing or damaged.

    Source:
        Mitsuba 3, plugin `measured`; docs/exchange.md.

    Example:
        >>> material = matcam.Microfacet(matcam.GGX(0.1), matcam.Conductor(0.2, 3.0))
        >>> matcam.exchange.rendered_sphere(material, size=32, samples=4).shape  # doctest: +SKIP
        (32, 32, 3)
        >>> matcam.exchange.rendered_sphere(material, size=8)
        Traceback (most recent call last):
        matcam.core.errors.ArgumentError: size must be a whole number in [16, 4096], got 8
    """
    for name, value, low, high in (("size", size, 16, 4096), ("samples", samples, 1, 1 << 16)):
        checks.whole_number(name, value, low, high)
    if not -np.pi < float(checks.scalar("lamp_angle", checks.number("lamp_angle", lamp_angle))) < np.pi:
        raise ArgumentError(f"lamp_angle must lie in ({-np.pi:.6g}, {np.pi:.6g}) rad, got {float(lamp_angle):g}")
    checks.extra("rendering", "render", "mitsuba")
    import mitsuba

    mitsuba.set_variant("scalar_rgb")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "material.bsdf"
        with one_by_one():  # written immediately, because Mitsuba reads the file
            write_rgl(path, adaptive_grid(material))
        scene = mitsuba.load_dict(_scene(mitsuba, path, lamp_angle, environment, size, samples))
        picture = np.asarray(mitsuba.render(scene), dtype=np.float32)
    return picture[..., :3]


def _scene(
    mitsuba: Any, path: Path, lamp_angle: float, environment: str | Path | None, size: int, samples: int
) -> dict[str, Any]:
    transform = mitsuba.ScalarTransform4f
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "direct", "hide_emitters": True},
        "sensor": {
            "type": "orthographic",
            "to_world": transform().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
            "film": {
                "type": "hdrfilm",
                "width": size,
                "height": size,
                "rfilter": {"type": "box"},
                "component_format": "float32",
                "pixel_format": "rgb",
            },
            "sampler": {"type": "multijitter", "sample_count": samples},
        },
        "sphere": {"type": "sphere", "bsdf": {"type": "measured", "filename": str(path)}},
    }
    if environment is not None:
        light = read_exr(environment)
        if light.ndim != 3 or light.shape[2] != 3 or not np.all(light >= 0) or not np.all(np.isfinite(light)):
            raise ArgumentError(f"{environment}: an environment must have three channels with finite values >= 0")
        return scene | {"environment": {"type": "envmap", "bitmap": mitsuba.Bitmap(light)}}
    towards = np.array([np.sin(lamp_angle), np.sin(lamp_angle) / 3, np.cos(lamp_angle)])
    lamp = {"type": "directional", "direction": (-towards).tolist(), "irradiance": {"type": "rgb", "value": np.pi}}
    # a uniform sky makes the shadow side of the sphere visible
    return scene | {"lamp": lamp, "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.2}}}
