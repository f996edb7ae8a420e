"""A sphere of a material, by Mitsuba 3 (extra `matcam[render]`): linear radiance, before any display."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from matcam.errors import ArgumentError
from matcam.exchange.parameterisation import adaptive_grid
from matcam.files.exr import read_exr
from matcam.files.rgl import write_rgl
from matcam.material.material import Material

_SKY = 0.2  # radiance of the even sky that a lone lamp leaves the rest of the sphere to be seen by
_VARIANT = "scalar_rgb"


def rendered_sphere(
    material: Material,
    *,
    lamp_angle: float = 0.7,
    environment: str | Path | None = None,
    size: int = 256,
    samples: int = 64,
) -> np.ndarray:
    """Radiance of a sphere that fills the picture, float32 (size, size, 3), NaN nowhere; row 0 on top.

    Lit by a distant lamp of irradiance pi, `lamp_angle` (rad, (-pi, pi)) from the camera towards +x and a third as far
    upwards, under an even sky of radiance 0.2: a white diffuse sphere has radiance 1 + 0.2 where it faces the lamp. Or by
    `environment`, an OpenEXR file of three channels (latitudes by longitudes) that takes the place of both. The camera is far
    away; its film is a box of one pixel in float32, because Mitsuba's own filter is a blur of half a pixel. Any material goes
    by way of `adaptive_grid`. ArgumentError where Mitsuba is not installed or a number is out of its range.
    """
    for name, value, low, high in (("size", size, 16, 4096), ("samples", samples, 1, 1 << 16)):
        if type(value) is not int or not low <= value <= high:
            raise ArgumentError(f"{name} must be a whole number from {low} to {high}, got {value!r}")
    if not -np.pi < lamp_angle < np.pi:
        raise ArgumentError(f"lamp_angle must lie in (-180, 180) degrees, got {np.degrees(lamp_angle):g}")
    mitsuba = _mitsuba()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "material.bsdf"
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
            raise ArgumentError(
                f"{environment}: an environment has three channels of finite radiance, nowhere negative"
            )
        return scene | {"environment": {"type": "envmap", "bitmap": mitsuba.Bitmap(light)}}
    towards = np.array([np.sin(lamp_angle), np.sin(lamp_angle) / 3, np.cos(lamp_angle)])
    lamp = {"type": "directional", "direction": (-towards).tolist(), "irradiance": {"type": "rgb", "value": np.pi}}
    return scene | {"lamp": lamp, "sky": {"type": "constant", "radiance": {"type": "rgb", "value": _SKY}}}


def _mitsuba() -> Any:
    try:
        import mitsuba
    except ImportError:
        raise ArgumentError("rendering needs an extra: pip install 'matcam[render]'") from None
    mitsuba.set_variant(_VARIANT)
    return mitsuba
