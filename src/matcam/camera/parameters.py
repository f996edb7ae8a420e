"""The numbers that describe a camera's parts, by the names that they bear in a profile: "optics.sigma_px", "optics.mtf[3]"."""

from __future__ import annotations

import operator
import re
from collections.abc import Mapping
from typing import Any

import equinox as eqx

from matcam._jax import jax, jnp
from matcam.camera.diffraction import DiffractionOptics
from matcam.camera.gaussian import GaussianOptics
from matcam.camera.measured import MeasuredOptics
from matcam.camera.pixel import BoxPixel, WindowedGaussianPixel

MODELS: dict[str, tuple[type, dict[str, str]]] = {
    "gaussian": (GaussianOptics, {"sigma_px": "sigma"}),
    "diffraction": (
        DiffractionOptics,
        {"f_number": "f_number", "wavelength_m": "wavelength", "pixel_pitch_m": "pixel_pitch"},
    ),
    "measured": (MeasuredOptics, {"frequency_cycles_per_px": "frequency", "mtf": "values"}),
    "box": (BoxPixel, {"half_width_px": "half_width"}),
    "windowed gaussian": (WindowedGaussianPixel, {"sigma_px": "sigma", "half_width_px": "half_width"}),
}
"""Model's name -> (class, {name with unit: attribute}); the constructor takes the attributes in this order."""

_NAME = re.compile(r"(\w+)\.(\w+?)(?:\[(\d+)\])?")


def model_of(module: eqx.Module) -> str:
    """Name of the model that a lens or a pixel is."""
    return next(name for name, (cls, _) in MODELS.items() if type(module) is cls)


def numbers(part: str, module: eqx.Module) -> dict[str, jax.Array]:
    """Scalars that describe `module`, which is the camera's `part` ("optics" or "pixel")."""
    named = {}
    for field, attribute in MODELS[model_of(module)][1].items():
        value = getattr(module, attribute)
        if isinstance(value, tuple):
            continue  # where a curve is sampled is known exactly
        if jnp.ndim(value):
            named.update({f"{part}.{field}[{i}]": value[i] for i in range(value.size)})
        else:
            named[f"{part}.{field}"] = value
    return named


def replaced(part: str, module: Any, values: Mapping[str, Any]) -> Any:
    """`module` with those of its numbers replaced that `values` names for this part. Works under JAX transformations."""
    for name, value in values.items():
        found = _NAME.fullmatch(name)
        if found is None or found[1] != part:
            continue
        attribute, index = MODELS[model_of(module)][1][found[2]], found[3]
        value = jnp.asarray(value, dtype=jnp.float64)
        new = value if index is None else getattr(module, attribute).at[int(index)].set(value)
        module = eqx.tree_at(operator.attrgetter(attribute), module, new)
    return module
