"""Choice of the lobe that explains the images best.

The candidates are lobes of two families. The chosen lobe is modified by a spline if this reduces the residual. A prior
that contradicts the images is widened until it agrees with them, and a remark reports the contradiction.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, cast

import numpy as np

from matcam.acquisition.check.unmeasured_lens import BY_SHAPE
from matcam.acquisition.merged_picture import MergedPicture
from matcam.core.remark import Remark
from matcam.inverse.fit.fit_setup import AUTO, CANDIDATES
from matcam.material.masking import Masking
from matcam.reconstruction.contradiction import contradiction, with_wider
from matcam.reconstruction.joint.likelihood import Likelihood, unexplained_share
from matcam.reconstruction.sphere_fit import SphereFit, fit_sphere, with_correlated_residuals
from matcam.reconstruction.sphere_scene import SphereScene, part_of

_SPLINE = 1.0
_FEWEST = 3
_NOISE_ALONE, _AS_NOISE = 0.003, 1.15
"""Noise alone explains the images if their unexplained share of the light, or their mean squared residual, is smaller."""
_CLEARLY, _AT_ONCE = 0.9, 0.5
"""Ratios of unexplained shares below which a spline modification is accepted: at the end, and before a specified value is
rejected.
"""
_DIFFUSE_PIXELS = 0.2
"""Share of pixels with mainly diffuse light, above which the shape of the diffuse part is considered."""
_SEEN = 3.0  # standard deviations of the noise above which a pixel contains light
_TURNS = 3  # number of sources that may be wrong
_ODD = 4.0
"""Ratio of chi squared of an image to the median above which the image is reported. Scatter of the lamps at most doubles it."""
_MANY, _SOME = 32, 16
"""Number of images above which the lobe is chosen with an even selection of images, and the size of the selection.

All images are fitted at the end.
"""
_HOPELESS = 1.5
"""Ratio of unexplained shares above which a lobe is not fitted again with other priors."""
_GUESSED = 0.25
"""Relative standard deviation above which the width of the lens is treated as a guess."""


class ChosenFit(NamedTuple):
    """Best fit, unexplained shares of all fitted lobes, and remarks.

    Attributes:
        fit: the best fit.
        tried: unexplained share of the light, no unit, by the name of the lobe.
        remarks: remarks on images, widened priors and the lobe.
        widened: factor by which the standard deviation of a source was multiplied, by the name of the source.
    """

    fit: SphereFit
    tried: dict[str, float]
    remarks: tuple[Remark, ...]
    widened: dict[str, float]


def chosen_fit(
    pictures: Sequence[MergedPicture],
    scene: SphereScene,
    lamps: np.ndarray,
    family: str = AUTO,
    *,
    masking: Masking = "smith",
    diffuse: bool = True,
    progress: Callable[[str], None] | None = None,
    fit_pictures: Callable[..., SphereFit] = fit_sphere,
) -> ChosenFit:
    """Fit lobes of the candidate families, and select the most probable fit.

    Args:
        pictures: merged images, one per lamp position.
        scene: prior knowledge of the rig.
        lamps: unit vectors to the lamps with which the search starts, (pictures, 3).
        family: family of the lobe. Default: "auto", the most probable candidate, spline-modified if that reduces the
            residual.
        masking: masking G of the lobe. Default: "smith".
        diffuse: True to include a Lambertian part. Default: True.
        progress: function that is called with a line about each step. Default: None.
        fit_pictures: function that fits one family, for samples other than a sphere. Default: `fit_sphere`.
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
            progress=lambda line: say(f"{_SOME} of {len(pictures)} images: {line}"),
            fit_pictures=fit_pictures,
        )
        first, remarks = few.fit.kind.family, [one for one in few.remarks if one.code != "picture-left-out"]
        for source, factor in few.widened.items():
            scene = with_wider(scene, source, factor)

    shaped = few is not None and few.fit.layout.shape > 0
    widened: dict[str, float] = {}

    def fitted(name: str, scene: SphereScene, start: SphereFit | None = None, **more: object) -> SphereFit:
        more = {"spline": _SPLINE if start is not None and start.kind.spline_size else 0.0, **more}
        return fit_pictures(
            pictures,
            scene,
            name,
            masking=masking,
            diffuse=diffuse,
            lamps=lamps,
            start=start,
            progress=lambda line: say(f"{_described(name, more, widened)}: {line}"),
            **{"shaped": shaped, **more},
        )

    chosen: dict[str, Any] = {"rivals": CANDIDATES[1:]} if family == AUTO else {}
    if few is not None:
        chosen = {"start": few.fit}
    best = fitted(first, scene, **chosen)
    tried = {best.kind.family: best.solution.unexplained}

    def with_shape(best: SphereFit) -> SphereFit:
        # if the rounds did not improve a fit with few parameters, more parameters do not help
        if not diffuse or best.stuck or _explained(best) or _diffuse_pixels(best) < _DIFFUSE_PIXELS:
            return best
        other = fitted(best.kind.family, scene, start=best, shaped=True)
        tried[f"{best.kind.family}, diffuse part shaped"] = other.solution.unexplained
        less = other.solution.unexplained < _CLEARLY * best.solution.unexplained
        return other if less and _likelier(other, best) else best

    def rivalled(best: SphereFit) -> SphereFit:
        for name in CANDIDATES:
            if family != AUTO or name == best.kind.family or _explained(best):
                continue
            if tried.get(name, 0.0) > _HOPELESS * best.solution.unexplained:
                continue
            # at the bound of a family its width is not a suitable start for another
            about = {} if _at_bound(best) else {"widths": np.exp(best.solution.p[0]) * np.array([0.4, 0.7, 1.1, 1.8])}
            other = fitted(name, scene, rounds=1, **about)
            tried[name] = other.solution.unexplained
            if _likelier(other, best) or _at_bound(best):
                again = fitted(name, scene, start=other)
                tried[name] = again.solution.unexplained
                best = again if _preferred(again, best) else best
        return best

    splines: list[SphereFit] = []

    def with_spline(best: SphereFit, share: float) -> SphereFit:
        name = f"{best.kind.family}, spline-modified"
        if (
            family != AUTO
            or best.kind.spline_size
            or _explained(best)
            or tried.get(name, 0.0) > best.solution.unexplained
        ):
            return best
        if not splines or splines[0] is not best:  # otherwise it is the same fit again
            splines[:] = [best, fitted(best.kind.family, scene, start=best, spline=_SPLINE)]
        other = splines[1]
        tried[name] = other.solution.unexplained
        if best.stuck and not _explained(other):
            return best  # clipping, a tone curve or a mirrored room, which no lobe explains
        return other if tried[name] < share * best.solution.unexplained and _likelier(other, best) else best

    if few is None:
        # before a source is rejected: with a wrong lobe, images are unexplained and specified values seem wrong
        best = with_shape(best)
        shaped = best.layout.shape > 0
        best = with_spline(rivalled(best), _AT_ONCE)
        if best.kind.spline_size:
            chosen = {"start": best}
    first, lost = best.kind.family, best.unexplained_pictures
    whole = pictures, scene, lamps
    if lost and len(pictures) - len(lost) >= _FEWEST:
        keep = [k for k in range(len(pictures)) if k not in lost]
        remarks.append(
            Remark(
                "picture-left-out",
                f"{', '.join(pictures[k].name for k in lost)}: the joint fit does not explain these images, which were left "
                "out: check their frames and lamp directions",
            )
        )
        pictures, lamps = [pictures[k] for k in keep], best.lamps[keep]
        scene = part_of(scene, keep)
        best = fitted(
            first,
            scene,
            **({"widths": np.exp(best.solution.p[:1])} if few is None and not best.kind.spline_size else chosen),
        )

    def final(best: SphereFit) -> SphereFit:
        """Refit with a wider prior of the gain for images that deviate strongly."""
        odd = _odd_pictures(best)
        if odd:
            gains = np.array(np.broadcast_to(scene.gain_std, len(pictures)), dtype=float)
            for k, share in odd.items():
                gains[k] = np.hypot(gains[k], share)
            wider = replace(scene, gain_std=gains)
            best = fitted(first, wider, start=best, rounds=1)
        best = _with_its_lens_open(with_correlated_residuals(best))
        remarks.extend(_odd_remark(best, k, share) for k, share in odd.items())
        return best

    if few is not None:
        return ChosenFit(final(best), few.tried, tuple(remarks), few.widened)
    hopeless = False
    for _ in range(_TURNS):
        found = contradiction(with_correlated_residuals(best), scene)
        if found is None:
            break
        source, factor, remark = found
        if source == "gain" and diffuse and not shaped and _diffuse_pixels(best) >= _DIFFUSE_PIXELS:
            # a diffuse part that departs from Lambert's law resembles light that varies between the images
            other = fitted(first, scene, start=best, shaped=True)
            tried[f"{first}, diffuse part shaped"] = other.solution.unexplained
            if contradiction(with_correlated_residuals(other), scene) is None:
                best, shaped = other, True
                break
        widened[source] = widened.get(source, 1.0) * factor
        remarks = [*(one for one in remarks if one.code != remark.code), remark]
        scene = with_wider(scene, source, factor)
        before, best = best, fitted(first, scene, start=best)
        hopeless = bool(best.stuck) and best.solution.unexplained > _CLEARLY * before.solution.unexplained
        if hopeless:
            break  # a specified value is not the cause either
    if widened and len(pictures) < len(whole[0]):
        # with a wrong source widened, the images left out may be explained, too
        kept = pictures, scene, lamps
        pictures, scene, lamps = whole
        for source, factor in widened.items():
            scene = with_wider(scene, source, factor)
        again = fitted(first, scene, **(chosen if best.kind.spline_size else {"widths": np.exp(best.solution.p[:1])}))
        if again.unexplained_pictures:
            pictures, scene, lamps = kept
        else:
            best, remarks = again, [one for one in remarks if one.code != "picture-left-out"]
    tried[f"{first}, spline-modified" if best.kind.spline_size else first] = best.solution.unexplained
    if not best.kind.spline_size and not hopeless:
        if len(pictures) < len(whole[0]) or widened:
            # under other priors, or without unexplained images, another lobe may be more probable
            best = rivalled(best)
        best = with_spline(best, _CLEARLY)
    if best.stuck:
        text = "the fit was stopped early, because the unexplained share of the light does not decrease ("
        text += (
            f"{', '.join(f'{share:.0%}' for share in best.stuck)}): look for clipping, a tone curve, or a mirrored room"
        )
        remarks.append(Remark("fit-stuck", text))
    if shaped:
        text = "Lambert's law does not explain the diffuse part: its shape was fitted"
        remarks.append(Remark("diffuse-not-lambertian", text))
    if best.kind.spline_size:
        text = f"no lobe of a single family explains the images: {best.kind.family} was modified by a spline"
        remarks.append(Remark("lobe-spline-modified", text))
    first = best.kind.family
    return ChosenFit(final(best), tried, tuple(remarks), widened)


def _odd_pictures(fit: SphereFit) -> dict[int, float]:
    solution = fit.solution
    usual = max(float(np.median(solution.chi2)), 1.0)
    odd = np.flatnonzero(solution.chi2 > _ODD * usual).tolist()
    return {k: unexplained_share(solution.problem, solution.p, [k]) for k in odd}


def _odd_remark(fit: SphereFit, k: int, share: float) -> Remark:
    chi2 = fit.solution.chi2
    text = f"{fit.names[k]}: the chi squared of this image is {chi2[k]:.1f}, but the median is {np.median(chi2):.1f}; "
    text += f"F of this image is {share:.1%} less certain: look for a second lamp, a reflection or dust in the image"
    return Remark("picture-odd", text)


def _described(name: str, more: Mapping[str, object], widened: Mapping[str, float]) -> str:
    name = " or ".join([name, *(str(one) for one in cast("Sequence[str]", more.get("rivals", ())))])
    spline = ", spline-modified" if more.get("spline") else ""
    shape = ", diffuse part shaped" if more.get("shaped") else ""
    return f"{name}{spline}{shape}" + (f", {' and '.join(widened)} widened" if widened else "")


def _with_its_lens_open(fit: SphereFit) -> SphereFit:
    """Increase the variance of a guessed lens to its prior variance if no lobe explains the images.

    With a wrong lobe, the fit otherwise underestimates the standard deviation of the lens.
    """
    solution, scene = fit.solution, fit.scene
    if scene.lens_std < _GUESSED or solution.unexplained < BY_SHAPE:
        return fit
    lens = fit.layout.of("lens")

    def opened(covariance: np.ndarray) -> np.ndarray:
        own = float(covariance[lens, lens])
        moved = covariance[:, lens] / max(own, 1e-30)
        return np.asarray(covariance + max(scene.lens_std**2 - own, 0.0) * np.outer(moved, moved))

    covariance, fitted = opened(solution.covariance), opened(solution.fitted)
    return replace(fit, solution=solution._replace(covariance=covariance, fitted=fitted))


def _explained(fit: SphereFit) -> bool:
    return fit.solution.unexplained < _NOISE_ALONE or float(np.median(fit.solution.chi2)) < _AS_NOISE


def _diffuse_pixels(fit: SphereFit) -> float:
    problem, p = fit.solution.problem, fit.solution.p
    more = []
    for k, pixels in enumerate(problem.pixels):
        recorded, _ = problem.recorded(p, k, slopes=False)
        diffuse = p[problem.layout.diffuse][pixels.channel] * recorded.lambert
        lobe = p[problem.layout.strengths(k)][pixels.channel] * recorded.lobe
        more.append((diffuse > lobe)[pixels.used & (pixels.values > _SEEN * pixels.std)])
    return float(np.mean(np.concatenate(more)))


def _likelier(one: SphereFit, other: SphereFit) -> bool:
    """Check whether `one` has a larger likelihood than `other`.

    Both likelihoods are computed with the smaller of the two unexplained shares.
    """
    judge = Likelihood(max(min(one.solution.unexplained, other.solution.unexplained), 1e-3))

    def surprise(fit: SphereFit) -> float:
        problem, p = fit.solution.problem, fit.solution.p
        return sum(
            judge.surprise(pixels, problem.picture(p, k, slopes=False).value) for k, pixels in enumerate(problem.pixels)
        )

    return surprise(one) < surprise(other)


def _preferred(one: SphereFit, other: SphereFit) -> bool:
    """Check whether `one` is preferred to `other`.

    The more probable fit is preferred. If exactly one of the fits has a lobe parameter at a bound, this fit is preferred
    only if its unexplained share is clearly smaller (`_CLEARLY`). At a bound, the family does not suit the material, and
    the width of the lobe is meaningless.
    """
    if _at_bound(one) == _at_bound(other):
        return _likelier(one, other)
    within, at_bound = (other, one) if _at_bound(one) else (one, other)
    clearly = at_bound.solution.unexplained < _CLEARLY * within.solution.unexplained
    return clearly == (at_bound is one)


def _at_bound(fit: SphereFit) -> bool:
    own, problem, p = len(fit.kind.family_names), fit.solution.problem, fit.solution.p
    return bool(np.any((p <= problem.low)[:own] | (p >= problem.high)[:own]))
