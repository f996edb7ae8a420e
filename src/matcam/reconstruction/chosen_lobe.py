"""The lobe that explains the pictures best: of two families, bent only where that explains what is left.

A prior that the pictures contradict is widened until it no longer does, and said: what was stated was wrong, or the model is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np

from matcam.acquisition.capture_check import BY_SHAPE
from matcam.acquisition.merged_picture import MergedPicture
from matcam.core.remark import Remark
from matcam.inverse.fit.fit_setup import AUTO, CANDIDATES
from matcam.material.masking import Masking
from matcam.reconstruction.joint.joint_fit import Likelihood, cost_at
from matcam.reconstruction.joint.joint_problem import JointProblem
from matcam.reconstruction.joint.unexplained import UnexplainedLight
from matcam.reconstruction.picture_model import SCENE
from matcam.reconstruction.sphere_fit import SphereFit, counted_alike, fit_sphere
from matcam.reconstruction.sphere_scene import Known, SphereScene, part_of, prior_of

_BEND = 1.0
_FEWEST = 3
_NOISE_ALONE, _AS_NOISE = 0.003, 1.15
"""Unexplained share of the light, and mean squared residual, up to either of which the noise alone explains the pictures."""
_CLEARLY, _AT_ONCE = 0.9, 0.5
"""Of the unexplained share: below which a bent lobe must come in the end, and before anything else is blamed."""
_CONTRADICTED = 2.5
"""Root mean square of a source's residuals, in its own standard deviations, from which it is taken as wrong."""
_FAR = 10.0
"""Standard deviations beyond which a distance is not printed: it is a first-order estimate."""
_EACH = 4.0
"""By how much a source must explain more for each value that it states: many values explain much by chance."""
_MUCH = 20.0
"""Fall of chi squared by freeing a source from which it is contradicted, though no prior alone is pushed far."""
_DIFFUSE_PIXELS = 0.2
"""Share of the pixels that show more diffuse light than lobe, from which the shape of the diffuse part is looked at."""
_SEEN = 3.0  # standard deviations of a pixel's noise from which it shows light
_TURNS = 3  # sources that may be wrong
_MANY, _SOME = 32, 16
"""Pictures beyond which the lobe is chosen by an even choice of them, and how many these are; all are fitted in the end."""
_HOPELESS = 1.5
"""A lobe that leaves so much more unexplained than the best is not tried again under other priors."""
_FREE = 1e3  # by this a standard deviation is multiplied to see what its source explains
_GUESSED = 0.25
"""Relative standard deviation from which a lens is a guess."""
_IN_EACH = ("lamp", "gain", "shift")
"""Sources that state something of each picture."""
_WIDENED = {
    "lens": "the lens differs from its profile",
    "distortion": "the lens's distortion is not as its profile states",
    "outline": "the highlights want another outline than the limb shows",
    "shift": "the sphere moves between the pictures by more than its limb says",
    "lamp": "the lamps are not where the table says",
    "camera distance": "the camera's distance is not as stated",
    "lamp distance": "the lamp's distance is not as stated",
    "rig": "the rig is not as the earlier reconstruction found it",
    "gain": "the light of the pictures varies more than stated",
}


class ChosenFit(NamedTuple):
    """Hold the best fit, what else was tried, and what is remarkable.

    Attributes:
        fit: the best.
        tried: unexplained share by the name of each lobe.
        remarks: of priors that were widened and of the lobe.
        widened: by what the standard deviation of a source was multiplied.
    """

    fit: SphereFit
    tried: dict[str, float]
    remarks: tuple[Remark, ...]
    widened: dict[str, float]


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
    few: ChosenFit | None = None
    if len(pictures) > _MANY:
        some = np.unique(np.linspace(0, len(pictures) - 1, _SOME).round().astype(int)).tolist()
        few = chosen_fit(
            [pictures[k] for k in some],
            part_of(scene, some),
            lamps[some],
            family,
            masking=masking,
            diffuse=diffuse,
            progress=lambda line: say(f"{_SOME} of {len(pictures)} pictures: {line}"),
            fit_pictures=fit_pictures,
        )
        first, remarks = few.fit.kind.family, [one for one in few.remarks if one.code != "picture-left-out"]
        for source, factor in few.widened.items():
            scene = _widened(scene, source, factor)

    shaped = few is not None and few.fit.layout.shape > 0

    def fitted(name: str, scene: SphereScene, **more: object) -> SphereFit:
        return fit_pictures(
            pictures,
            scene,
            name,
            masking=masking,
            diffuse=diffuse,
            lamps=lamps,
            progress=lambda line: say(f"{name}: {line}"),
            **{"shaped": shaped, **more},
        )

    chosen: dict[str, object] = {"rivals": CANDIDATES[1:]} if family == AUTO else {}
    if few is not None:
        chosen = {"start": few.fit, "bend": _BEND if few.fit.kind.bends else 0.0}
    best = fitted(first, scene, **chosen)
    tried = {best.kind.family: best.solution.unexplained}

    def with_shape(best: SphereFit) -> SphereFit:
        """Return the fit whose diffuse part is not Lambert's, where that leaves less unexplained."""
        if not diffuse or _explained(best) or _diffuse_pixels(best) < _DIFFUSE_PIXELS:
            return best
        other = fitted(best.kind.family, scene, start=best, shaped=True)
        tried[f"{best.kind.family}, diffuse part shaped"] = other.solution.unexplained
        less = other.solution.unexplained < _CLEARLY * best.solution.unexplained
        return other if less and _likelier(other, best) else best

    def rivalled(best: SphereFit) -> SphereFit:
        """Return the likeliest of a fit that noise alone does not explain and those of the other candidates."""
        for name in CANDIDATES:
            if family != AUTO or name == best.kind.family or _explained(best):
                continue
            if tried.get(name, 0.0) > _HOPELESS * best.solution.unexplained:
                continue
            # at the end of a family its width says nothing of another's
            about = {} if _at_bound(best) else {"widths": np.exp(best.solution.p[0]) * np.array([0.4, 0.7, 1.1, 1.8])}
            other = fitted(name, scene, rounds=1, **about)
            tried[name] = other.solution.unexplained
            if _likelier(other, best) or _at_bound(best):
                again = fitted(name, scene, start=other)
                tried[name] = again.solution.unexplained
                best = again if _preferred(again, best) else best
        return best

    bends: list[SphereFit] = []

    def bent(best: SphereFit, share: float) -> SphereFit:
        """Return the fit bent smoothly, where that leaves less than a share of what is unexplained."""
        name = f"{best.kind.family}, bent"
        if family != AUTO or best.kind.bends or _explained(best) or tried.get(name, 0.0) > best.solution.unexplained:
            return best
        if not bends or bends[0] is not best:  # else it is the same fit, met again
            bends[:] = [best, fitted(best.kind.family, scene, start=best, bend=_BEND)]
        other = bends[1]
        tried[name] = other.solution.unexplained
        return other if tried[name] < share * best.solution.unexplained and _likelier(other, best) else best

    if few is None:
        # before anything is blamed: a wrong lobe makes pictures unexplained, and what is stated look wrong
        best = with_shape(best)
        shaped = best.layout.shape > 0
        best = bent(rivalled(best), _AT_ONCE)
        if best.kind.bends:
            chosen = {"start": best, "bend": _BEND}
    first, lost = best.kind.family, best.unexplained_pictures
    whole = pictures, scene, lamps
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
        best = fitted(
            first, scene, **({"widths": np.exp(best.solution.p[:1])} if few is None and not best.kind.bends else chosen)
        )
    if few is not None:
        return ChosenFit(_with_its_lens_open(counted_alike(best)), few.tried, tuple(remarks), few.widened)
    widened: dict[str, float] = {}
    for _ in range(_TURNS):
        found = _contradiction(counted_alike(best), scene)
        if found is None:
            break
        source, factor, remark = found
        widened[source] = widened.get(source, 1.0) * factor
        remarks = [*(one for one in remarks if one.code != remark.code), remark]
        scene = _widened(scene, source, factor)
        best = fitted(first, scene, start=best, bend=_BEND if best.kind.bends else 0.0)
    if widened and len(pictures) < len(whole[0]):
        # what was stated was wrong: with that mended, the pictures left out may be explained, too
        kept = pictures, scene, lamps
        pictures, scene, lamps = whole
        for source, factor in widened.items():
            scene = _widened(scene, source, factor)
        again = fitted(first, scene, **(chosen if best.kind.bends else {"widths": np.exp(best.solution.p[:1])}))
        if again.unexplained_pictures:
            pictures, scene, lamps = kept
        else:
            best, remarks = again, [one for one in remarks if one.code != "picture-left-out"]
    tried[f"{first}, bent" if best.kind.bends else first] = best.solution.unexplained
    if not best.kind.bends:
        if len(pictures) < len(whole[0]) or widened:
            # under other priors, or without what no lobe explained, another one may be likelier
            best = rivalled(best)
        best = bent(best, _CLEARLY)
    if shaped:
        text = "Lambert's law does not explain the diffuse part: its shape was fitted"
        remarks.append(Remark("diffuse-not-lambertian", text))
    if best.kind.bends:
        text = f"no lobe of a single family explains the pictures: {best.kind.family} was bent smoothly"
        remarks.append(Remark("lobe-bent", text))
    return ChosenFit(_with_its_lens_open(counted_alike(best)), tried, tuple(remarks), widened)


def _with_its_lens_open(fit: SphereFit) -> SphereFit:
    """Return the fit with what is stated of a guessed lens as the error of the lens, where no lobe explains the pictures.

    The wrong lobe's shape would tell them apart: on a real ball three families each knew the lens to 2 % and differed by 15 %.
    """
    solution, scene = fit.solution, fit.scene
    if scene.lens_std < _GUESSED or solution.unexplained < BY_SHAPE:
        return fit
    lens = fit.layout.lobe + SCENE.index("lens")

    def opened(covariance: np.ndarray) -> np.ndarray:
        own = float(covariance[lens, lens])
        moved = covariance[:, lens] / max(own, 1e-30)
        return np.asarray(covariance + max(scene.lens_std**2 - own, 0.0) * np.outer(moved, moved))

    covariance, fitted = opened(solution.covariance), opened(solution.fitted)
    return replace(fit, solution=solution._replace(covariance=covariance, fitted=fitted))


def _explained(fit: SphereFit) -> bool:
    """Say whether photon and read noise explain the pictures: then no other lobe is looked for."""
    return fit.solution.unexplained < _NOISE_ALONE or float(np.median(fit.solution.chi2)) < _AS_NOISE


def _diffuse_pixels(fit: SphereFit) -> float:
    """Return the share of the pixels in which more than half of the light is the diffuse part's."""
    problem, p = fit.solution.problem, fit.solution.p
    more = []
    for k, pixels in enumerate(problem.pixels):
        recorded, _ = problem.recorded(p, k, slopes=False)
        diffuse = p[problem.layout.diffuse][pixels.channel] * recorded.lambert
        lobe = p[problem.layout.strengths(k)][pixels.channel] * recorded.lobe
        more.append((diffuse > lobe)[pixels.used & (pixels.values > _SEEN * pixels.std)])
    return float(np.mean(np.concatenate(more)))


def _likelier(one: SphereFit, other: SphereFit) -> bool:
    """Say whether a fit explains its pixels better than another, both judged by the smaller unexplained share."""
    judge = Likelihood(UnexplainedLight(max(min(one.solution.unexplained, other.solution.unexplained), 1e-3)))
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


def _preferred(one: SphereFit, other: SphereFit) -> bool:
    """Say whether a fit is taken for another: the likelier, but no lobe at the end of its family that explains little more.

    What is there is no lobe of that family: a spike with long tails takes the place of a haze, and its width says nothing.
    """
    if _at_bound(one) == _at_bound(other):
        return _likelier(one, other)
    within, at_bound = (other, one) if _at_bound(one) else (one, other)
    clearly = at_bound.solution.unexplained < _CLEARLY * within.solution.unexplained
    return clearly == (at_bound is one)


def _at_bound(fit: SphereFit) -> bool:
    """Say whether a parameter of the lobe is at the end of what its family has."""
    own, problem, p = len(fit.kind.family_names), fit.solution.problem, fit.solution.p
    return bool(np.any((p <= problem.low)[:own] | (p >= problem.high)[:own]))


class _Blame(NamedTuple):
    """Say what freeing a source explains (a fall of chi squared), and by how many standard deviations it then is off.

    Attributes:
        explains: to first order, less what that many values explain by chance.
        source: its name.
        pull: by how many standard deviations.
        step: how the parameters then move, (size,).
        freed: the problem without that source.
    """

    explains: float
    source: str
    pull: float
    step: np.ndarray
    freed: JointProblem

    def holds(self, fit: SphereFit) -> bool:
        """Say whether chi squared truly falls by much on the way.

        Freed of what is stated in each picture, little is left that determines it, and the first order goes astray.
        """
        if self.source not in _IN_EACH:
            return True
        judge, p = Likelihood(fit.solution.left), fit.solution.p
        problem = self.freed
        ways = [np.clip(p + share * self.step, problem.low, problem.high) for share in (1.0, 0.3, 0.1)]
        return fit.solution.cost - min(cost_at(problem, judge, one) for one in ways) > _MUCH


def _contradiction(fit: SphereFit, scene: SphereScene) -> tuple[str, float, Remark] | None:
    """Return the source that contradicts the pictures, by what its standard deviation is to be multiplied, and a remark.

    A wrong prior that is stiff pushes others away. So each is freed in turn, and the one that explains most by that is to
    blame. None: no prior is pushed away, and freeing none explains much.
    """
    problem = fit.solution.problem
    away = problem.prior_rows @ fit.solution.p - problem.prior_values
    sources = np.array(problem.prior_sources)
    pushed = any(_rms(away[sources == name]) > _CONTRADICTED for name in _WIDENED if np.any(sources == name))
    blamed = max(_blamed(fit, scene), key=lambda one: one.explains, default=None)
    if blamed is None or not (pushed or (blamed.explains > _MUCH and blamed.holds(fit))):
        return None
    pull = max(blamed.pull, _CONTRADICTED)
    remark = Remark(
        f"{blamed.source.replace(' ', '-')}-contradicted",
        f"{_WIDENED[blamed.source]}: {times_off(pull)} the given standard deviation, which was enlarged; the distance is "
        "extrapolated from the fit within it",
    )
    return blamed.source, 1.5 * pull, remark


def times_off(pull: float) -> str:
    """Format a distance in standard deviations. It is a first-order estimate, whose digits mean nothing far away."""
    return f"off by more than {_FAR:.0f} times" if pull > _FAR else f"off by about {pull:.0f} times"


def _blamed(fit: SphereFit, scene: SphereScene) -> list[_Blame]:
    """Return what freeing each source would explain, to first order, less `_EACH` for each value that it states."""
    solution, problem = fit.solution, fit.solution.problem
    away = problem.prior_rows @ solution.p - problem.prior_values
    pictures = problem.layout.pictures
    values = {"outline": 3, "shift": 2 * pictures, "lamp": 2 * pictures, "gain": pictures}
    found: list[_Blame] = []
    for name in _WIDENED:
        rows = _rows_of(name, problem.prior_sources)
        if not rows.any() or (name == "distortion" and scene.camera.field is None):
            continue  # not stated, or not fitted
        wide, wanted, sources = prior_of(problem.layout, _widened(scene, name, _FREE), problem.frames, 0.0, 0)
        chosen = _rows_of(name, sources)
        wide, old = wide[chosen], problem.prior_rows[rows]
        off = wide @ solution.p - wanted[chosen]
        push = old.T @ away[rows] - wide.T @ off
        step = solution.covariance_without(old.T @ old - wide.T @ wide) @ push
        count = values.get(name, int(rows.sum()))
        explains = float(away[rows] @ away[rows] - off @ off + push @ step) - _EACH * count
        pull = float(np.sqrt(np.sum((away[rows] + old @ step) ** 2) / count))
        # no source explains more than there is to explain: where the first order says so, it does not hold
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
    """Return which rows of a prior state a source; the sphere's shifts stand in those of the outline."""
    return np.array([one == ("outline" if name == "shift" else name) for one in sources])


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _widened(scene: SphereScene, source: str, factor: float) -> SphereScene:
    if source == "lamp":
        return replace(scene, lamp_std=np.asarray(scene.lamp_std) * factor)
    if source == "rig":
        assert scene.rig is not None
        return replace(scene, rig=scene.rig._replace(covariance=scene.rig.covariance * factor**2))
    if source == "distortion":
        field = scene.camera.field
        assert field is not None
        return replace(scene, camera=scene.camera.with_field(field.wider(factor)))
    if source == "gain":
        return replace(scene, gain_std=np.asarray(scene.gain_std) * factor)
    if source == "outline":
        return replace(scene, outline_covariance=scene.outline_covariance * factor**2)
    if source == "shift":
        return replace(scene, shift_std=scene.shift_std * factor)
    if source == "camera distance":
        return replace(scene, camera_nearness=Known(scene.camera_nearness.value, scene.camera_nearness.std * factor))
    if source == "lamp distance":
        return replace(scene, lamp_nearness=Known(scene.lamp_nearness.value, scene.lamp_nearness.std * factor))
    return replace(scene, lens_std=scene.lens_std * factor)
