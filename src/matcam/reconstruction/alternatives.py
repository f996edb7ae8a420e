"""Explanations of the images of a sample, and their probabilities (docs/reconstruct.md).

An explanation is a joint fit with a family of the lobe. Optionally, the lobe is spline-modified, the diffuse part departs from
Lambert's law, and the standard deviations of some specified values are increased. The search starts with the family that fits a
few images best. In each step the explanation is changed in one respect. The evidence of each change is predicted, and the
changes are fitted in the order of the prediction, until one increases the evidence. The search ends if none does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from matcam.acquisition.check.unmeasured_lens import BY_SHAPE
from matcam.acquisition.merged_picture import MergedPicture
from matcam.core.arrays import evenly
from matcam.core.remark import Remark
from matcam.inverse.fit.fit_setup import AUTO, CANDIDATES
from matcam.material.diffuse_shape import TERMS
from matcam.material.ndf.free_lobe import KNOTS
from matcam.reconstruction.contradiction import contradiction_remark, specified_sources, with_wider
from matcam.reconstruction.joint.evidence import ACCURACY, ComparedPixels, Judged
from matcam.reconstruction.joint.likelihood import unexplained_share
from matcam.reconstruction.picture_model import lamp_coordinates
from matcam.reconstruction.sphere_fit import SphereFit, with_correlated_residuals
from matcam.reconstruction.sphere_scene import SphereScene, joint_problem, part_of, prior_of, with_light
from matcam.reconstruction.stated.captured_scene import CapturedScene

_SPLINE = 1.0
"""Prior standard deviation of the second differences of ln D of a spline modification, no unit."""
_MANY, _SOME = 32, 16
"""Number of images above which the explanation is chosen with an even selection of images, and the size of the selection.

All images are fitted at the end.
"""


class Alternative(NamedTuple):
    """Description of an explanation.

    Attributes:
        family: family of the lobe.
        spline: True for a spline-modified lobe. Default: False.
        shaped: True if the diffuse part may depart from Lambert's law. Default: False.
        wider: names of sources, and factors by which their standard deviations are multiplied. Default: (), as specified.
    """

    family: str
    spline: bool = False
    shaped: bool = False
    wider: tuple[tuple[str, float], ...] = ()

    @property
    def name(self) -> str:
        spline = ", spline-modified" if self.spline else ""
        shape = ", diffuse part shaped" if self.shaped else ""
        return f"{self.family}{spline}{shape}" + "".join(
            f", {source} widened {factor:.3g} times" for source, factor in self.wider
        )

    @property
    def log_prior(self) -> float:
        """Logarithm of the prior probability, without that of the lobe, which is the same for all."""
        # a source is wrong with a prior probability of 1 %
        return float(len(self.wider) * np.log(0.01))

    def widened(self, source: str, factor: float) -> Alternative:
        factors = dict(self.wider)
        factors[source] = factors.get(source, 1.0) * factor
        return self._replace(wider=tuple(factors.items()))

    def scene(self, specified: SphereScene) -> SphereScene:
        """Apply the larger standard deviations to the specified values."""
        for source, factor in self.wider:
            specified = with_wider(specified, source, factor)
        return specified


class TriedExplanation(NamedTuple):
    """Explanation that was fitted.

    Attributes:
        name: description of the explanation.
        unexplained: unexplained share of the light, no unit.
        probability: posterior probability, no unit; the sum over all tried explanations is 1.
    """

    name: str
    unexplained: float
    probability: float


@dataclass
class _Search:
    """Fitted explanations of the same images.

    Attributes:
        pictures: merged images.
        scene: prior knowledge as specified.
        lamps: unit vectors to the lamps with which fits start, (pictures, 3).
        fit_pictures: function that fits one explanation to images.
        free: True if the lobe may be of another family, or spline-modified.
        diffuse: True if there is a diffuse part.
        say: function that is called with a line about each step.
        fits: fit of each explanation.
    """

    pictures: Sequence[MergedPicture]
    scene: SphereScene
    lamps: np.ndarray
    fit_pictures: Callable[..., SphereFit]
    free: bool
    diffuse: bool
    say: Callable[[str], None]
    fits: dict[Alternative, SphereFit] = field(default_factory=dict, init=False)

    def part(self, keep: Sequence[int]) -> _Search:
        """Build a search with some of the images."""
        pictures = [self.pictures[k] for k in keep]
        return replace(self, pictures=pictures, scene=part_of(self.scene, keep), lamps=self.lamps[list(keep)])

    def fitted(self, one: Alternative, rivals: Sequence[str] = (), **more: object) -> SphereFit:
        """Fit an explanation, or one with a lobe of another family that fits better at the start.

        Args:
            one: the explanation.
            rivals: other families. Default: ().
            **more: further arguments of `fit_sphere`, such as `start`.
        """
        name = " or ".join([one.name, *rivals])
        if one not in self.fits:
            found: SphereFit = self.fit_pictures(
                self.pictures,
                one.scene(self.scene),
                one.family,
                diffuse=self.diffuse,
                spline=_SPLINE if one.spline else 0.0,
                shaped=one.shaped,
                lamps=self.lamps,
                rivals=rivals,
                progress=lambda line: self.say(f"explanation {name}: {line}"),
                **more,
            )
            one = one._replace(family=found.kind.family)
            self.fits[one] = with_correlated_residuals(found)
        return self.fits[one]

    def most_probable(self, one: Alternative, *, sources: bool = True) -> Alternative:
        """Improve an explanation in one respect at a time as long as the evidence increases.

        Args:
            one: explanation with which the search starts, which is fitted.
            sources: False to keep the specified standard deviations. Default: True.
        """
        while (better := self._better(one, sources=sources)) != one:
            stuck = bool(self.fits[one].stuck) and bool(self.fits[better].stuck)
            one = better
            if stuck:
                break  # clipping, a tone curve or a mirrored room, which no explanation describes
        return one

    def probabilities(self, best: Alternative) -> dict[Alternative, float]:
        """Compute the posterior probabilities of the explanations that were fitted, for the pixels of `best`."""
        compared = ComparedPixels.of(self.fits[best].solution)
        logs = np.array([self._log_evidence(one, self._judged(compared, one)) for one in self.fits])
        if not np.isfinite(logs).any():
            return {best: 1.0}
        shares = np.exp(logs - logs.max())
        return dict(zip(self.fits, (shares / shares.sum()).tolist(), strict=True))

    def _better(self, one: Alternative, *, sources: bool) -> Alternative:
        fit = self.fits[one]
        compared = ComparedPixels.of(fit.solution)
        judged = self._judged(compared, one)
        now = self._log_evidence(one, judged)
        changes = self._changes(one, compared, judged, sources=sources)
        # largest number of changes that are fitted in one step of the search
        for gain, change in sorted(changes, key=lambda pair: -pair[0])[:3]:
            if gain <= 0 and np.isfinite(now):
                break
            self.fitted(change, start=fit)
            if self._log_evidence(change, self._judged(compared, change)) > now:
                return change
        return one

    def _judged(self, compared: ComparedPixels, one: Alternative) -> Judged:
        fit = self.fits[one]
        return compared.judged(fit.solution.problem, fit.kind, fit.solution.p)

    def _log_evidence(self, one: Alternative, judged: Judged) -> float:
        """Compute the logarithm of the evidence, times the prior probability of wrong sources.

        It is minus infinity if a parameter of the family is at a bound. Laplace's approximation is then wrong, because the
        family does not describe the material, and the width of the lobe is meaningless.
        """
        own, problem, p = len(self.fits[one].kind.family_names), judged.problem, judged.p
        at_bound = np.any((p <= problem.low)[:own] | (p >= problem.high)[:own])
        return -np.inf if at_bound else judged.log_evidence() + one.log_prior

    def _changes(
        self, one: Alternative, compared: ComparedPixels, judged: Judged, *, sources: bool
    ) -> list[tuple[float, Alternative]]:
        """Predict the gain of log evidence of explanations that differ in one respect.

        A lobe of another family is approximated by a spline modification, so the prediction of the latter holds for both. The
        lobe and the diffuse part are not changed if noise explains the pixels within specified values.

        Args:
            one: present explanation.
            compared: pixels of its fit.
            judged: terms of its evidence.
            sources: False to keep the specified standard deviations.
        """
        fit, problem, changes = self.fits[one], judged.problem, list[tuple[float, Alternative]]()
        now = judged.log_evidence_with(problem.prior_rows, problem.prior_values)
        spline, own = _SPLINE if one.spline else 0.0, len(fit.kind.family_names)
        for source, factors in specified_sources(fit) if sources else ():
            found = []
            for factor in factors:
                change = one.widened(source, float(factor))
                rows, values, _ = prior_of(
                    fit.layout, change.scene(self.scene), problem.frames, spline, own, fit.nearness
                )
                gain = judged.log_evidence_with(rows, values) - now + change.log_prior - one.log_prior
                found.append((gain, change))
            changes.append(max(found, key=lambda pair: pair[0]))
        if judged.share > ACCURACY or any(gain > 0 for gain, _ in changes):
            if self.free and not one.spline and not fit.kind.stretched:
                gain = self._predicted(compared, fit, KNOTS, fit.layout.shape) - now
                changes += [(gain, one._replace(family=name)) for name in CANDIDATES if name != one.family]
                changes.append((gain, one._replace(spline=True)))
            if self.diffuse and not one.shaped:
                gain = self._predicted(compared, fit, fit.kind.spline_size, TERMS) - now
                changes.append((gain, one._replace(shaped=True)))
        return [(gain, change) for gain, change in changes if change not in self.fits]

    def _predicted(self, compared: ComparedPixels, fit: SphereFit, spline_size: int, shape: int) -> float:
        """Predict the evidence with additional parameters of the lobe or of the diffuse part."""
        problem, p, kind = fit.solution.problem, fit.solution.p, fit.kind._replace(spline_size=spline_size)
        layout = problem.layout._replace(lobe=kind.size, shape=shape)
        other = joint_problem(
            layout,
            kind,
            fit.scene,
            problem.frames,
            replace(problem.model, kind=kind),  # type: ignore[type-var]
            problem.pixels,
            slope=problem.slope,
            diffuse=self.diffuse,
            spline=_SPLINE if spline_size else 0.0,
            nearness=fit.nearness,
        )
        q = np.concatenate([layout.shared_of(p, problem.layout), p[problem.layout.shared :]])
        return compared.judged(other, kind, q).log_evidence_with(other.prior_rows, other.prior_values)


def chosen_fit(
    captured: CapturedScene,
    family: str,
    fit_pictures: Callable[..., SphereFit],
    *,
    diffuse: bool,
    say: Callable[[str], None],
) -> tuple[SphereFit, tuple[TriedExplanation, ...], list[Remark]]:
    """Fit explanations of the images, and choose the most probable one.

    Args:
        captured: merged images, prior knowledge, and directions to the lamps with which the search starts.
        family: family of the lobe; "auto" for the most probable candidate, spline-modified if this is more probable.
        fit_pictures: function that fits one explanation, with the interface of `fit_sphere`.
        diffuse: True to include a diffuse part.
        say: function that is called with a line about each step.

    Returns:
        The fit, whose covariance includes the differences from other probable explanations; the explanations that were fitted;
        and remarks on images, specified values and the lobe.
    """
    pictures = captured.pictures
    whole = _Search(pictures, captured.scene, captured.lamps, fit_pictures, family == AUTO, diffuse, say)
    if len(pictures) > _MANY:
        part = whole.part(evenly(len(pictures), _SOME).tolist())
        part.say = lambda line: say(f"{_SOME} of {len(pictures)} images: {line}")
        search, best, shares = _explored(part, family)
        whole.fitted(best, start=search.fits[best])
        tried = tuple(_tried(search, shares))
        search, shares = _without_unexplained(whole, best), {best: 1.0}
    else:
        search, best, shares = _explored(whole, family)
        tried = tuple(_tried(search, shares))
    found, remarks = _with_odd_pictures(search, best)
    found = _with_others(_with_its_lens_open(found), search.fits, shares)
    return found, tried, [*_remarks(found, best, shares, search, whole), *remarks]


def _explored(whole: _Search, family: str) -> tuple[_Search, Alternative, dict[Alternative, float]]:
    """Search the most probable explanation of images, without those that no lobe explains."""
    first = CANDIDATES[0] if family == AUTO else family
    rivals = CANDIDATES[1:] if family == AUTO else ()
    start = Alternative(whole.fitted(Alternative(first), rivals).kind.family)
    search = whole
    if whole.fits[start].unexplained_pictures:
        # with a wrong lobe, images are unexplained, and specified values seem wrong
        best = whole.most_probable(start, sources=False)
        search = _without_unexplained(whole, best)
        search.fitted(start, start=whole.fits[best])  # the fit that exists if no image was left out
    best = search.most_probable(start)
    if search is not whole and best.wider:
        # with other specified values, the images that were left out may be explained, too
        again = whole.fitted(best, start=search.fits[best])
        search = search if again.unexplained_pictures else whole
    shares = search.probabilities(best)
    return search, max(shares, key=lambda one: shares[one]), shares


def _without_unexplained(search: _Search, best: Alternative) -> _Search:
    fit = search.fits[best]
    keep = [k for k in range(len(search.pictures)) if k not in fit.unexplained_pictures]
    # smallest number of images that may remain if others are left out
    if len(keep) == len(search.pictures) or len(keep) < 3:
        return search
    part = search.part(keep)
    part.fitted(best, start=fit)
    return part


def _tried(search: _Search, shares: Mapping[Alternative, float]) -> list[TriedExplanation]:
    return [TriedExplanation(one.name, search.fits[one].solution.unexplained, share) for one, share in shares.items()]


def _remarks(
    fit: SphereFit, best: Alternative, shares: Mapping[Alternative, float], search: _Search, whole: _Search
) -> list[Remark]:
    remarks = []
    lost = [one.name for one in whole.pictures if one.name not in fit.names]
    if lost:
        text = f"{', '.join(lost)}: the joint fit does not explain these images, which were left "
        remarks.append(Remark("picture-left-out", text + "out: check their frames and lamp directions"))
    # probability above which a source that may be wrong is reported
    probable = [one for one, share in sorted(shares.items(), key=lambda pair: -pair[1]) if share > 0.05]
    for source in dict.fromkeys(source for one in probable for source, _ in one.wider):
        by = [one for one in probable if source in dict(one.wider)]
        probability = sum(share for one, share in shares.items() if source in dict(one.wider))
        remarks.append(contradiction_remark(source, search.fits[by[0]], search.scene, probability))
    if fit.stuck:
        shares_after = ", ".join(f"{share:.0%}" for share in fit.stuck)
        text = "the fit was stopped early, because the unexplained share of the light does not decrease "
        text += f"({shares_after}): look for clipping, a tone curve, or a mirrored room"
        remarks.append(Remark("fit-stuck", text))
    if best.shaped:
        text = "Lambert's law does not explain the diffuse part: its shape was fitted"
        remarks.append(Remark("diffuse-not-lambertian", text))
    if best.spline:
        text = f"no lobe of a single family explains the images: {best.family} was modified by a spline"
        remarks.append(Remark("lobe-spline-modified", text))
    return remarks


def _with_odd_pictures(search: _Search, best: Alternative) -> tuple[SphereFit, list[Remark]]:
    """Refit with a wider prior of the gain for images that deviate strongly, which remarks report."""
    fit = search.fits[best]
    solution = fit.solution
    # scatter of the lamps at most doubles chi squared
    odd = np.flatnonzero(solution.chi2 > 4.0 * max(float(np.median(solution.chi2)), 1.0)).tolist()
    if not odd:
        return fit, []
    shares = {k: unexplained_share(solution.problem, solution.p, [k]) for k in odd}
    wider = np.array([shares.get(k, 0.0) for k in range(len(search.pictures))])
    scene = with_light(search.scene, lambda light: light.with_error(wider))
    fit = replace(search, scene=scene).fitted(best, start=fit, rounds=1)
    chi2, remarks = fit.solution.chi2, []
    for k, share in shares.items():
        text = (
            f"{fit.names[k]}: the chi squared of this image is {chi2[k]:.1f}, but the median is {np.median(chi2):.1f}; "
        )
        advice = "look for a second lamp, a reflection or dust in the image"
        text += f"F of this image is {share:.1%} less certain: {advice}"
        remarks.append(Remark("picture-odd", text))
    return fit, remarks


def _with_others(
    fit: SphereFit, fits: Mapping[Alternative, SphereFit], shares: Mapping[Alternative, float]
) -> SphereFit:
    """Add the mean squared differences from other explanations, weighted by their probabilities, to the covariance.

    Not compared are lobes of different families, and a shape of the diffuse part that only one explanation has.
    """
    solution, layout = fit.solution, fit.layout
    more = np.zeros_like(solution.covariance)
    for one, share in shares.items():
        other = fits[one]
        # probability below which an explanation is neglected
        if share < 1e-3 or other.names != fit.names:
            continue
        shared = layout.shared_of(other.solution.p, other.layout) - solution.p[: layout.shared]
        if other.kind.family != fit.kind.family:
            shared[: layout.lobe] = 0.0
        if not other.layout.shape:
            shared[layout.diffuse_shape.start :] = 0.0
        own = other.solution.p[other.layout.shared :] - solution.p[layout.shared :]
        away = np.concatenate([shared, own])
        for k, frame in enumerate(solution.problem.frames):
            away[layout.turn(k)] = lamp_coordinates(frame, other.lamps[k]) - lamp_coordinates(frame, fit.lamps[k])
        more += share * np.outer(away, away)
    solution = solution._replace(covariance=solution.covariance + more, fitted=solution.fitted + more)
    return replace(fit, solution=solution)


def _with_its_lens_open(fit: SphereFit) -> SphereFit:
    """Increase the variance of a guessed lens to its prior variance if no lobe explains the images.

    With a wrong lobe, the fit otherwise underestimates the standard deviation of the lens.
    """
    solution, scene = fit.solution, fit.scene
    # the width of a lens that is known to 25 % or worse is a guess
    if scene.lens_std < 0.25 or solution.unexplained < BY_SHAPE:
        return fit
    lens = fit.layout.of("lens")

    def opened(covariance: np.ndarray) -> np.ndarray:
        own = float(covariance[lens, lens])
        moved = covariance[:, lens] / max(own, 1e-30)
        return np.asarray(covariance + max(scene.lens_std**2 - own, 0.0) * np.outer(moved, moved))

    covariance, fitted = opened(solution.covariance), opened(solution.fitted)
    return replace(fit, solution=solution._replace(covariance=covariance, fitted=fitted))
