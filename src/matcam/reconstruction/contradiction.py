"""Specified values that may contradict the images.

A source is a group of specified values, such as the lens or the directions to the lamps. An explanation of the images may
increase the standard deviation of a source.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from matcam.core.remark import Remark
from matcam.reconstruction.sphere_fit import SphereFit
from matcam.reconstruction.sphere_scene import SphereScene, prior_of, with_light

_FAR = 10.0
"""Number of standard deviations beyond which a distance is printed as a lower limit."""
_LEAST_FACTOR, _LARGEST_FACTOR, _FACTORS = 2.0, 1e3, 10
"""Range and number of the factors by which the standard deviation of a source may be too small."""
_LENGTHS = {
    "camera distance": "camera_nearness",
    "lamp distance": "lamp_nearness",
    "sample radius": "sample_radius",
}
"""Field of the scene with the value of each length."""
_CONTRADICTED = {
    "lens": "the lens differs from its profile",
    "distortion": "the distortion of the lens differs from its profile",
    "outline": "the highlights indicate an outline that differs from the limb",
    "shift": "the sphere moves between the images by more than its limb indicates",
    "lamp": "the directions to the lamps differ from the table",
    "camera distance": "the camera distance differs from the specified value",
    "lamp distance": "the lamp distance differs from the specified value",
    "sample radius": "the sample radius in mm differs from the specified value",
    "rig": "the rig differs from that of the earlier reconstruction",
    "gain": "the light of the images varies more than specified",
}


def specified_sources(fit: SphereFit) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the name of each specified source of a fit, and factors by which its standard deviation may be too small."""
    for source in _CONTRADICTED:
        if not _rows_of(source, fit.solution.problem.prior_sources).any():
            continue  # not specified, or not fitted
        if source == "distortion" and fit.scene.camera.field is None:
            continue
        largest = _LARGEST_FACTOR
        if source in _LENGTHS:
            known = getattr(fit.scene, _LENGTHS[source])
            # the standard deviation of a length may be up to 10 %; a length specified as exact may be 2 %
            # wrong
            largest = max(largest, 0.1 * known.value / max(known.std, 1e-30))
        yield source, np.geomspace(_LEAST_FACTOR, largest, _FACTORS)


def contradiction_remark(source: str, fit: SphereFit, scene: SphereScene, probability: float) -> Remark:
    """Build the remark that the specified values of a source contradict the images.

    Args:
        source: name of the source.
        fit: fit with a larger standard deviation of the source.
        scene: prior knowledge as specified.
        probability: probability that the source is wrong, no unit.
    """
    p, layout = fit.solution.p, fit.layout
    rows, values, sources = prior_of(layout, scene, fit.solution.problem.frames, 0.0, 0, fit.nearness)
    own = _rows_of(source, sources)
    pull = float(np.sqrt(np.mean((rows @ p - values)[own] ** 2)))
    # probability above which a wrong source is reported without its probability
    text = f"probability {probability:.0%}: " if probability < 0.95 else ""
    text += _CONTRADICTED[source]
    if source == "sample radius" and scene.sample_radius is not None:
        stated = scene.sample_radius.value
        wanted = stated * np.exp(float(p[layout.sample_radius]))
        text += f" (the images indicate {wanted:.4g} mm, but {stated:.4g} mm is specified)"
    return Remark(
        f"{source.replace(' ', '-')}-contradicted",
        f"{text}; according to the fit, the given value is {times_off(pull)} its standard deviation, which was therefore "
        "enlarged: check the given value",
    )


def times_off(pull: float) -> str:
    """Format the distance of a specified value from the images, in standard deviations.

    A large distance is formatted as a lower limit, because it depends on the standard deviation that the fit assumes.
    """
    return f"off by more than {_FAR:.0f} times" if pull > _FAR else f"off by about {pull:.0f} times"


def _rows_of(source: str, sources: tuple[str, ...]) -> np.ndarray:
    """Compute a mask of the rows of the prior that belong to a source.

    The rows of the source "shift" are those of the outline.
    """
    return np.array([one == ("outline" if source == "shift" else source) for one in sources], dtype=bool)


def with_wider(scene: SphereScene, source: str, factor: float) -> SphereScene:
    """Multiply the standard deviation of the specified values of one source by a factor.

    Args:
        scene: specified values and their standard deviations.
        source: name of the source, one of `_CONTRADICTED`.
        factor: factor of the standard deviation, no unit.
    """
    change: dict[str, Any]
    if source in _LENGTHS:
        known = getattr(scene, _LENGTHS[source])
        change = {_LENGTHS[source]: known._replace(std=known.std * factor)}
    elif source == "outline":
        change = {"outline_covariance": scene.outline_covariance * factor**2}
    elif source == "rig":
        assert scene.rig is not None
        change = {"rig": scene.rig._replace(covariance=scene.rig.covariance * factor**2)}
    elif source == "distortion":
        field = scene.camera.field
        assert field is not None
        change = {"camera": scene.camera.with_field(field.wider(factor))}
    elif source == "gain":
        return with_light(scene, lambda light: light.wider(factor))
    else:  # lens, lamp or shift
        change = {f"{source}_std": np.asarray(getattr(scene, f"{source}_std")) * factor}
    return replace(scene, **change)
