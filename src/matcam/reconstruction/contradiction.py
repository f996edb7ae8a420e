"""Detection of specified values that contradict the images.

A source is a group of specified values, such as the lens or the directions to the lamps. The prior of each source is
widened in turn, to find the source whose error explains the largest part of chi squared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from matcam.core.remark import Remark
from matcam.reconstruction.joint.joint_fit import cost_at
from matcam.reconstruction.joint.joint_problem import JointProblem
from matcam.reconstruction.sphere_fit import SphereFit
from matcam.reconstruction.sphere_scene import SphereScene, prior_of

_FAR = 10.0
"""Number of standard deviations beyond which a distance is not printed, because it is a first-order estimate."""
_CONTRADICTED = 2.5
"""Root mean square of the residuals of a source, in its standard deviations, above which the source is wrong."""
_EACH = 4.0
"""Decrease of chi squared per specified value that is attributed to chance when a source is freed."""
_MUCH = 20.0
"""Decrease of chi squared above which the values of a freed source are wrong, even if each single residual is small."""
_FREE = 1e3  # factor of a standard deviation that frees its source
_LENGTH = 0.1
"""Smallest relative standard deviation of a freed length. A length specified as exact may be 2 % wrong."""
_IN_EACH = ("lamp", "gain", "shift")
"""Sources with a value for each image."""
_LENGTHS = {
    "camera distance": "camera_nearness",
    "lamp distance": "lamp_nearness",
    "sample radius": "sample_radius",
}
"""Field of the scene with the value of each length."""
_WIDENED = {
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


class _Blame(NamedTuple):
    """Effect of freeing a source, which means that its prior is made very wide.

    Attributes:
        explains: first-order decrease of chi squared, less the decrease that is expected by chance.
        source: name of the source.
        pull: distance of the freed values from the specified values, in specified standard deviations.
        step: first-order change of the parameters, (size,).
        freed: problem with the wide prior of the source.
    """

    explains: float
    source: str
    pull: float
    step: np.ndarray
    freed: JointProblem

    def holds(self, fit: SphereFit) -> bool:
        """Check that chi squared decreases by more than `_MUCH` along the step.

        Only a source with one value per image is checked. The images hardly determine its values once it is freed, so the
        first-order prediction is inaccurate.
        """
        if self.source not in _IN_EACH:
            return True
        judge, p, problem = fit.solution.likelihood, fit.solution.p, self.freed
        points = [np.clip(p + share * self.step, problem.low, problem.high) for share in (1.0, 0.3, 0.1)]
        return fit.solution.cost - min(cost_at(problem, judge, one) for one in points) > _MUCH


def contradiction(fit: SphereFit, scene: SphereScene) -> tuple[str, float, Remark] | None:
    """Find the source that contradicts the images.

    A wrong but narrow prior displaces other parameters. Therefore each source is freed in turn, and the source with the
    largest decrease of chi squared is selected.

    Returns:
        Name of the source, factor by which its standard deviation is to be multiplied, and a remark. None if the residuals
        of all priors are small, and no freed source decreases chi squared much.
    """
    problem = fit.solution.problem
    away = problem.prior_rows @ fit.solution.p - problem.prior_values
    sources = np.array(problem.prior_sources)
    pushed = any(np.mean(away[sources == name] ** 2) > _CONTRADICTED**2 for name in set(sources) & set(_WIDENED))
    blamed = max(_blamed(fit, scene), key=lambda one: one.explains, default=None)
    if blamed is None or not (pushed or (blamed.explains > _MUCH and blamed.holds(fit))):
        return None
    pull = max(blamed.pull, _CONTRADICTED)
    text = _WIDENED[blamed.source]
    if blamed.source == "sample radius" and scene.sample_radius is not None:
        stated = scene.sample_radius.value
        wanted = stated * np.exp(float((fit.solution.p + blamed.step)[problem.layout.sample_radius]))
        text += f" (the images indicate {wanted:.4g} mm, but {stated:.4g} mm is specified)"
    remark = Remark(
        f"{blamed.source.replace(' ', '-')}-contradicted",
        f"{text}; according to the fit, the given value is {times_off(pull)} its standard deviation, which was therefore "
        "enlarged: check the given value",
    )
    return blamed.source, 1.5 * pull, remark


def times_off(pull: float) -> str:
    """Format the distance of a specified value from the images, in standard deviations.

    A large distance is formatted as a lower limit, because it is an inaccurate first-order estimate.
    """
    return f"off by more than {_FAR:.0f} times" if pull > _FAR else f"off by about {pull:.0f} times"


def _blamed(fit: SphereFit, scene: SphereScene) -> list[_Blame]:
    """Compute the first-order decrease of chi squared when each source is freed.

    The expected decrease by chance, `_EACH` per specified value, is subtracted.
    """
    solution, problem = fit.solution, fit.solution.problem
    away = problem.prior_rows @ solution.p - problem.prior_values
    pictures = problem.layout.pictures
    values = {"outline": 3, "shift": 2 * pictures, "lamp": 2 * pictures, "gain": pictures}
    found: list[_Blame] = []
    for name in _WIDENED:
        rows = _rows_of(name, problem.prior_sources)
        if not rows.any() or (name == "distortion" and scene.camera.field is None):
            continue  # not specified, or not fitted
        wide, wanted, sources = prior_of(
            problem.layout, with_wider(scene, name, _freeing(scene, name)), problem.frames, 0.0, 0
        )
        chosen = _rows_of(name, sources)
        wide, old = wide[chosen], problem.prior_rows[rows]
        off = wide @ solution.p - wanted[chosen]
        push = old.T @ away[rows] - wide.T @ off
        step = solution.covariance_without(old.T @ old - wide.T @ wide) @ push
        count = values.get(name, int(rows.sum()))
        explains = float(away[rows] @ away[rows] - off @ off + push @ step) - _EACH * count
        pull = float(np.sqrt(np.sum((away[rows] + old @ step) ** 2) / count))
        # no source explains more than the total: a larger first-order estimate is invalid
        if explains < solution.cost and np.isfinite(pull):
            others = ~rows
            freed = replace(
                problem,
                prior_rows=np.concatenate([problem.prior_rows[others], wide]),
                prior_values=np.concatenate([problem.prior_values[others], wanted[chosen]]),
                prior_sources=(),
            )
            found.append(_Blame(explains, name, pull, step, freed))
    return found


def _rows_of(name: str, sources: Sequence[str]) -> np.ndarray:
    """Compute a mask of the rows of the prior that belong to a source.

    The rows of the source "shift" are those of the outline.
    """
    return np.array([one == ("outline" if name == "shift" else name) for one in sources])


def _freeing(scene: SphereScene, source: str) -> float:
    known = None if source not in _LENGTHS else getattr(scene, _LENGTHS[source])
    return _FREE if known is None else max(_FREE, _LENGTH * known.value / max(known.std, 1e-30))


def with_wider(scene: SphereScene, source: str, factor: float) -> SphereScene:
    """Multiply the standard deviation of the specified values of one source by a factor.

    Args:
        scene: specified values and their standard deviations.
        source: name of the source, one of `_WIDENED`.
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
    else:  # lens, lamp, gain or shift
        change = {f"{source}_std": np.asarray(getattr(scene, f"{source}_std")) * factor}
    return replace(scene, **change)
