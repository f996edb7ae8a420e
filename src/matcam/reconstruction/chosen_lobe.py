"""The lobe that explains the pictures best: of two families, bent only where that explains what is left.

A prior that the pictures contradict is widened until it no longer does, and said: what was stated was wrong, or the model is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np

from matcam.acquisition.merged_picture import MergedPicture
from matcam.core.remark import Remark
from matcam.inverse.fit.fit_setup import AUTO, CANDIDATES
from matcam.material.masking import Masking
from matcam.reconstruction.joint_fit import Likelihood
from matcam.reconstruction.sphere_fit import SphereFit, fit_sphere
from matcam.reconstruction.sphere_scene import Known, SphereScene, part_of

_BEND = 1.0
_FEWEST = 3
_NOISE_ALONE, _AS_NOISE = 0.003, 1.15
"""Unexplained share of the light, and mean squared residual, up to either of which the noise alone explains the pictures."""
_CLEARLY = 0.9  # of the unexplained share: what a bent lobe must at least take away
_CONTRADICTED = 2.5
"""Root mean square of a source's residuals, in its own standard deviations, from which it is taken as wrong."""
_WIDENED = {
    "lens": "the lens differs from its profile",
    "outline": "the highlights want another outline than the limb shows",
    "lamp": "the lamps are not where the table says",
    "camera distance": "the camera's distance is not as stated",
    "lamp distance": "the lamp's distance is not as stated",
    "gain": "the light of the pictures varies more than stated",
}


class ChosenFit(NamedTuple):
    """Hold the best fit, what else was tried, and what is remarkable.

    Attributes:
        fit: the best.
        tried: unexplained share by the name of each lobe.
        remarks: of priors that were widened and of the lobe.
    """

    fit: SphereFit
    tried: dict[str, float]
    remarks: tuple[Remark, ...]


class FitOfPictures(Protocol):
    """Fit one family of lobes to all pictures of a sample: `fit_sphere`, or what stands in for it."""

    def __call__(
        self, pictures: Sequence[MergedPicture], scene: SphereScene, family: str = "ggx", **more: object
    ) -> SphereFit:
        """Return the fit; further arguments as of `fit_sphere`."""


def chosen_fit(
    pictures: Sequence[MergedPicture],
    scene: SphereScene,
    lamps: np.ndarray,
    family: str = AUTO,
    *,
    masking: Masking = "smith",
    diffuse: bool = True,
    progress: Callable[[str], None] | None = None,
    fit_pictures: FitOfPictures = fit_sphere,  # type: ignore[assignment]
) -> ChosenFit:
    """Fit lobes of the candidate families and return the likeliest.

    Args:
        pictures: merged pictures.
        scene: what is known beforehand.
        lamps: directions to the lamps as the highlights say, (pictures, 3).
        family: family of the lobe; "auto": the likelier of the candidates, bent where that explains more. Default: "auto".
        masking: the lobe's G. Default: "smith".
        diffuse: whether there is a Lambertian part. Default: True.
        progress: is called with a line about each step. Default: None.
        fit_pictures: fits one family; of another sample than a sphere, its own. Default: `fit_sphere`.
    """
    say = progress or (lambda _: None)
    first = CANDIDATES[0] if family == AUTO else family
    remarks: list[Remark] = []

    def fitted(name: str, scene: SphereScene, **more: object) -> SphereFit:
        return fit_pictures(
            pictures,
            scene,
            name,
            masking=masking,
            diffuse=diffuse,
            lamps=lamps,
            progress=lambda line: say(f"{name}: {line}"),
            **more,
        )

    best = fitted(first, scene)
    tried = {first: best.solution.unexplained}
    lost = best.unexplained_pictures
    if lost and len(pictures) - len(lost) >= _FEWEST:
        keep = [k for k in range(len(pictures)) if k not in lost]
        remarks.append(
            Remark(
                "picture-left-out",
                f"{', '.join(pictures[k].name for k in lost)}: not explained by the joint fit; left out",
            )
        )
        pictures, lamps = [pictures[k] for k in keep], best.lamps[keep]
        scene = part_of(scene, keep)
        best = fitted(first, scene, widths=np.exp(best.solution.p[:1]))
        tried[first] = best.solution.unexplained
    wider, said = _without_contradiction(best, scene)
    if said:
        remarks.extend(said)
        scene = wider
        best = fitted(first, scene, start=best)
        tried[first] = best.solution.unexplained
    if family == AUTO and not _explained(best):
        for name in CANDIDATES[1:]:
            width = float(np.exp(best.solution.p[0]))
            other = fitted(name, scene, widths=width * np.array([0.4, 0.7, 1.1, 1.8]), rounds=1)
            tried[name] = other.solution.unexplained
            if _likelier(other, best):
                best = fitted(name, scene, start=other)
                tried[name] = best.solution.unexplained
    if family == AUTO and not _explained(best):
        bent = fitted(best.kind.family, scene, start=best, bend=_BEND)
        tried[f"{best.kind.family}, bent"] = bent.solution.unexplained
        if bent.solution.unexplained < _CLEARLY * best.solution.unexplained and _likelier(bent, best):
            best = bent
            remarks.append(
                Remark(
                    "lobe-bent",
                    f"no lobe of a single family explains the pictures: {best.kind.family} was bent smoothly",
                )
            )
    return ChosenFit(best, tried, tuple(remarks))


def _explained(fit: SphereFit) -> bool:
    """Say whether photon and read noise explain the pictures: then no other lobe is looked for."""
    return fit.solution.unexplained < _NOISE_ALONE or float(np.median(fit.solution.chi2)) < _AS_NOISE


def _likelier(one: SphereFit, other: SphereFit) -> bool:
    """Say whether a fit explains its pixels better than another, both judged by the smaller unexplained share."""
    judge = Likelihood(max(min(one.solution.unexplained, other.solution.unexplained), 1e-3))
    surprise = []
    for fit in (one, other):
        solution = fit.solution
        surprise.append(
            sum(
                judge.surprise(pixels, solution.problem.picture(solution.p, k, slopes=False).value)
                for k, pixels in enumerate(solution.problem.pixels)
            )
        )
    return surprise[0] < surprise[1]


def _without_contradiction(fit: SphereFit, scene: SphereScene) -> tuple[SphereScene, list[Remark]]:
    """Return the scene with every prior widened that the pictures contradict, and a remark on each."""
    problem, p = fit.solution.problem, fit.solution.p
    away = problem.prior_rows @ p - problem.prior_values
    remarks = []
    for source, words in _WIDENED.items():
        rows = [index for index, one in enumerate(problem.prior_sources) if one == source]
        if not rows:
            continue
        pull = float(np.sqrt(np.mean(away[rows] ** 2)))
        if pull < _CONTRADICTED:
            continue
        scene = _widened(scene, source, 1.5 * pull)
        remarks.append(
            Remark(
                f"{source.replace(' ', '-')}-contradicted",
                f"{words}: off by {pull:.1f} times the stated standard deviation, which was widened",
            )
        )
    return scene, remarks


def _widened(scene: SphereScene, source: str, factor: float) -> SphereScene:
    if source == "lamp":
        return replace(scene, lamp_std=np.asarray(scene.lamp_std) * factor)
    if source == "gain":
        return replace(scene, gain_std=np.asarray(scene.gain_std) * factor)
    if source == "outline":
        return replace(
            scene, outline_covariance=scene.outline_covariance * factor**2, shift_std=scene.shift_std * factor
        )
    if source == "camera distance":
        return replace(scene, camera_nearness=Known(scene.camera_nearness.value, scene.camera_nearness.std * factor))
    if source == "lamp distance":
        return replace(scene, lamp_nearness=Known(scene.lamp_nearness.value, scene.lamp_nearness.std * factor))
    return replace(scene, lens_std=scene.lens_std * factor)
