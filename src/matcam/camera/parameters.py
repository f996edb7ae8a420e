"""The numbers that describe a camera's parts, by the names that they bear in a profile: "optics.sigma_px", "optics.mtf[3]",
"optics.core.sigma_px"."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx

from matcam.camera.optics.gaussian import GaussianOptics
from matcam.camera.optics.halo import HaloOptics
from matcam.camera.optics.measured import MeasuredOptics
from matcam.camera.optics.pupil import DefocusOptics, DiffractionOptics
from matcam.camera.pixel import BoxPixel, WindowedGaussianPixel
from matcam.core.jax import jax, jnp

MODELS: dict[str, tuple[type, dict[str, str]]] = {
    "gaussian": (GaussianOptics, {"sigma_px": "sigma"}),
    "diffraction": (
        DiffractionOptics,
        {"f_number": "f_number", "wavelength_m": "wavelength", "pixel_pitch_m": "pixel_pitch"},
    ),
    "defocus": (
        DefocusOptics,
        {
            "f_number": "focused.f_number",
            "wavelength_m": "focused.wavelength",
            "pixel_pitch_m": "focused.pixel_pitch",
            "blur_diameter_px": "blur_diameter",
        },
    ),
    "measured": (MeasuredOptics, {"frequency_cycles_per_px": "frequency", "mtf": "values"}),
    "halo": (HaloOptics, {"core": "core", "fraction": "fraction", "radius_px": "halo.sigma"}),
    "box": (BoxPixel, {"half_width_px": "half_width"}),
    "windowed gaussian": (WindowedGaussianPixel, {"sigma_px": "sigma", "half_width_px": "half_width"}),
}
"""Model's name -> (class, {name with unit: attribute}); the constructor takes the attributes in this order."""

_NAME = re.compile(r"((?:\w+\.)+)(\w+?)(?:\[(\d+)\])?")


def model_of(module: eqx.Module) -> str:
    """Name of the model that a lens or a pixel is."""
    return next(name for name, (cls, _) in MODELS.items() if type(module) is cls)


def values_of(module: eqx.Module) -> dict[str, Any]:
    """What describes a lens or a pixel, by names with units: scalars, curves, and the lens inside a lens."""
    return {field: operator.attrgetter(path)(module) for field, path in MODELS[model_of(module)][1].items()}


def numbers(part: str, module: eqx.Module) -> dict[str, jax.Array]:
    """Scalars that describe `module`, which is the camera's `part` ("optics", "pixel" or "optics.core")."""
    named = {}
    for field, value in values_of(module).items():
        if isinstance(value, eqx.Module):
            named.update(numbers(f"{part}.{field}", value))
        elif isinstance(value, tuple):
            continue  # where a curve is sampled is known exactly
        elif jnp.ndim(value):
            named.update({f"{part}.{field}[{i}]": value[i] for i in range(value.size)})
        else:
            named[f"{part}.{field}"] = value
    return named


def replaced(part: str, module: Any, values: Mapping[str, Any]) -> Any:
    """`module` with those of its numbers replaced that `values` names for this part. Works under JAX transformations."""
    for name, value in values.items():
        found = _NAME.fullmatch(name)
        if found is None or found[1].split(".")[0] != part:
            continue
        path = _path(module, found[1].split(".")[1:-1], found[2])
        value = jnp.asarray(value, dtype=jnp.float64)
        new = value if found[3] is None else path(module).at[int(found[3])].set(value)
        module = eqx.tree_at(path, module, new)
    return module


def _path(module: eqx.Module, inner: list[str], field: str) -> Callable[[Any], Any]:
    """The way from a lens to one of its numbers, through the lenses inside it."""
    steps = []
    for name in (*inner, field):
        steps.append(MODELS[model_of(module)][1][name])
        module = operator.attrgetter(steps[-1])(module)
    return operator.attrgetter(".".join(steps))
