"""Explanations of a table, weighted by their evidence (docs/correct.md).

An explanation is a model of the table, with or without a camera. `correct` and `fresnel` use the same explanations, so their
results are consistent. Every explanation is fitted to the same cells. The Fresnel term F is free in every slice, and a diffuse
part is added. The explanations are:

- A lobe of each family through the camera. The uncertainty of the lens (width and shape) is a prior of the fit.
- If the residuals of all these fits exceed pixel noise: Student's t with a free tail exponent, two lobes, a lobe of each family
  over a rough base, and a spline-modified lobe, all through the camera.
- The best lobe without a camera, and, if none of the explanations above describes the data, a lobe of each channel without a
  camera and with any smooth masking.

The explanations are compared in a few slices, and the probable ones are fitted to more slices. The result is their mean,
weighted by their posterior probabilities (`evidence`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from matcam.camera.sensor import PixelNoise
from matcam.core.errors import FitError
from matcam.core.remark import Remark
from matcam.core.workspace import Workspace
from matcam.forward.pixel_grid import grid_of
from matcam.inverse.correction.evidence import OtherLobe, Weighing, channel_misfit, noise_without_model
from matcam.inverse.correction.lobe_shape import ShapeUncertainty, known_shape, shape_uncertainty
from matcam.inverse.correction.rig_refits import RigRefit, rig_refits
from matcam.inverse.correction.spline_lobe import in_all_slices
from matcam.inverse.fit.fit_data import SEARCH_STEP, at_largest_noise, check_values, noise_text
from matcam.inverse.fit.fit_parameters import STUDENT, TWO_LOBES
from matcam.inverse.fit.fit_setup import AUTO, CANDIDATES, FitSetup, free_setup
from matcam.inverse.fit.material_fit import MaterialFit
from matcam.inverse.operator.pixel_phase import LocatedRig
from matcam.inverse.operator.sample_view import sample_view
from matcam.inverse.rig.rig_axes import LAMP, LENS, is_guess, known_lens, widths_of
from matcam.material.masking import Masking
from matcam.rigs import Rig

_WIDEST_SPLINE = 1.0
"""Largest standard deviation of the second differences of ln D (no unit), with which a family hardly constrains the lobe."""
_STIFF = 0.125
"""Share of the half width of a lobe below which its spline modification is stiff, because broad lobes have no finer
structure.
"""
_SMOOTH_CORES = ("ggx", STUDENT)
"""Families to which a spline modification may be applied. Unlike the lobe of EPD they have no cusp, which no pixel could
resolve.
"""
_HOPELESS = 15.0
"""Difference of log evidence to the best explanation above which an explanation is not fitted to more slices. It corresponds to
a probability of 3e-7, which more slices would reduce further.
"""
PROBABLE = 0.95
"""Probability of the explanations without a camera above which the data show no blur."""
_UNLIKELY = 0.05
"""Largest probability of the explanations without a camera at which a guessed lens is used."""
_NEGLIGIBLE = 1e-3
"""Probability below which another lobe is neglected."""
_MISFIT = 0.75
"""Share of misfit in the variance of the residuals above which no lobe explains the data. The noise that the fit estimates is
then more than twice the noise of a pixel.
"""
CHANNELS_DIFFER = "channels-differ"
"""Code of the remark that the channels have different lobes."""
UNEXPLAINED = "unexplained"
"""Code of the remark that no explanation describes the data."""


class Member(NamedTuple):
    """Explanation of a table: a fit and its setup."""

    setup: FitSetup
    fit: MaterialFit


class Explanation(NamedTuple):
    """Explanations of a table and their probabilities.

    Attributes:
        located: rig that recorded the table, with its cell rule.
        setup: setup of `fit`.
        candidates: fits through the camera that were fitted to all slices of the setup.
        fit: most probable of the candidates.
        shape: uncertainty of the shape of the lobe of `fit`.
        base: fit of the lobe of `fit` in the slices of `refits`.
        others: candidates other than `fit` that are not negligible, with their probabilities.
        refits: fits with one parameter of the rig free.
        blind_setup: setup of `blind`.
        blind: best fit of a lobe without a camera.
        no_camera: probability of the explanations without a camera (no unit).
        shadowed: fit without a camera of one lobe per channel with free masking, if it is the best fit without a camera;
            otherwise None.
        weighing: noise model that weights the residuals.
    """

    located: LocatedRig
    setup: FitSetup
    candidates: list[MaterialFit]
    fit: MaterialFit
    shape: ShapeUncertainty
    base: MaterialFit
    others: tuple[OtherLobe, ...]
    refits: tuple[RigRefit, ...]
    blind_setup: FitSetup
    blind: MaterialFit
    no_camera: float
    shadowed: MaterialFit | None
    weighing: Weighing

    @property
    def without_camera(self) -> MaterialFit:
        return self.shadowed or self.blind

    @property
    def no_blur(self) -> bool:
        return self.no_camera > PROBABLE

    @property
    def contradicts(self) -> bool:
        """True if rig and data contradict each other.

        This is the case if the data show no blur, another lens than specified, or equal values of cells that no pixel grid
        explains. It is also the case if no lobe explains the data, so that the estimated noise has its largest value.
        """
        return (
            self.located.unexplained
            or self.no_blur
            or (not self.fit.noise_given and at_largest_noise(self.fit.noise))
            or any(refit.contradicts for refit in self.refits if refit.axis.name == LENS)
        )

    @property
    def undecided(self) -> bool:
        """True if the width of the lens is a guess and the data do not determine the blur."""
        camera = self.located.rig.camera
        lens = known_lens(camera).uncertainty
        if lens is None or LENS not in lens.names or self.no_camera <= _UNLIKELY:
            return False
        return is_guess(LENS, lens.std()[LENS] / float(camera.parameters()[LENS]))

    def scattering(self, lit: MaterialFit) -> MaterialFit:
        """Select the fit with the most slices, whose F determines the image gains.

        lit: fit that is preferred if several fits have the same number of slices.
        """
        return max((lit, self.fit, *self.candidates), key=lambda one: one.theta_d.size)

    @property
    def no_blur_remark(self) -> Remark:
        noise = [noise_text(fit.noise) for fit in (self.blind, self.fit, self.without_camera)]
        text = (
            f"the data show no blur by this camera: the noise of a pixel would be {noise[0]} without the camera and {noise[1]} "
            "with the camera"
        )
        if self.shadowed is not None:
            text += f", and {noise[2]} without the camera but with free shadowing and one lobe per channel"
        text += (
            "; check the camera and the radius of the sample, because a wrong radius of the sample has the same effect"
        )
        return Remark("no-blur-in-data", text)

    @property
    def channel_misfit(self) -> float:
        """Difference between the lobes of the channels that pixel noise does not explain, relative to the lobe (no unit).

        It is 0 if the noise of a pixel is unknown.
        """
        return channel_misfit(self.fit, self.weighing.noise) if self.weighing.known else 0.0

    @property
    def remarks(self) -> tuple[Remark, ...]:
        remarks = [*self.fit.remarks, *self.located.remarks]
        if self.fit.has_spline:
            remarks.append(self.shape.remark(self.fit.family))
        # few cells with large residuals hardly change the robust chi squared, but the estimated noise
        pixel, fitted = self.weighing.noise.relative, self.fit.noise.relative
        share = 1 - min(self.weighing.kappa, 1.0 if self.fit.noise_given else (pixel / max(pixel, fitted)) ** 2)
        if self.weighing.known and (self.weighing.unexplained or share > _MISFIT):
            remarks.append(
                Remark(
                    UNEXPLAINED,
                    f"pixel noise ({self.weighing.noise.relative:.1%}) does not explain {share:.0%} of the "
                    "variance of the residuals: no lobe that was tried explains the data fully; check the rig",
                )
            )
        apart = self.channel_misfit
        if apart > self.weighing.noise.relative:
            remarks.append(
                Remark(
                    CHANNELS_DIFFER,
                    f"the lobes of the channels differ by {apart:.1%} of their values in addition to noise, so the lens or the "
                    "roughness differs between the channels: specify a camera with a lens for each colour (camera-RGB.json of "
                    "`matcam calibrate`)",
                )
            )
        return (*remarks, *(refit.remark for refit in self.refits if refit.contradicts))


def first_setup(
    brdf: xr.DataArray,
    rig: Rig,
    *,
    masking: Masking,
    noise: PixelNoise | None,
    workspace: Workspace | None,
    slice_step: int = SEARCH_STEP,
) -> FitSetup:
    """Build the setup from which `explain` derives all others.

    Args:
        brdf: checked table, 1/sr.
        rig: rig that recorded the table, as `located_rig` returns it.
        masking: masking G of the lobe, as for `correct`.
        noise: noise of a pixel; None: it is estimated.
        workspace: store of results that depend only on the rig; None: that of the process.
        slice_step: spacing of the slices that are used (no unit). Default: SEARCH_STEP.

    Raises:
        FitError: the table has too few values.
    """
    setup = free_setup([brdf], rig, masking=masking, noise=noise, slice_step=slice_step, workspace=workspace)
    check_values(setup.tables, setup.rig, slice_step)
    # not the lens: the nodes of a rule for lenses of any width resolve narrow lobes less well
    refitted = tuple(name for name in (LAMP,) if name in widths_of(rig))
    return setup.with_(lens_shape=not known_lens(rig.camera).exact, refitted=refitted)


def explain(setup: FitSetup, located: LocatedRig, ndf: str) -> Explanation:
    """Fit the explanations of a table, and compute their probabilities.

    Args:
        setup: result of `first_setup` for the table.
        located: rig of the setup, with its cell rule.
        ndf: family of the lobe, or "auto".
    """
    rig, slice_step = located.rig, setup.slice_step
    families = CANDIDATES if ndf == AUTO else (ndf,)
    few = setup.with_few_slices()
    try:
        ranked = [_solved(few.with_(ndf=family)) for family in families]
    except FitError:  # the values of the table lie in other slices
        few = setup
        ranked = [_solved(few.with_(ndf=family)) for family in families]
    noise = noise_without_model(setup, ranked[0].fit)
    weighing = _weighing(ranked, noise)
    if not any(weighing.complete(one.fit) for one in ranked):
        ranked += [_solved(few.with_(ndf=family)) for family in ((STUDENT, TWO_LOBES) if ndf == AUTO else ())]
        ranked += [_solved(few.with_(ndf=family, base=True)) for family in families]
        ranked.append(
            _with_spline(_closest([one for one in ranked if one.setup.ndf in _SMOOTH_CORES] or ranked, noise))
        )
    closest = _closest(ranked, noise)
    pairs = [(closest, _without_camera(closest, rig))]
    shadows: list[Member] = []
    weighing = _weighing([*ranked, pairs[0][1]], noise)
    if weighing.unexplained:
        shadows.append(with_free_masking(ranked[0], rig))
        weighing = _weighing([*ranked, pairs[0][1], *shadows], noise)
    logs = [weighing.log_evidence(one.fit) for one in ranked]
    best = ranked[int(np.argmax(logs))]
    if best is not closest:
        pairs.append((best, _without_camera(best, rig)))
    others = [*(one for _, one in pairs), *shadows]
    blind = max((one for _, one in pairs), key=lambda one: weighing.log_evidence(one.fit))
    no_camera = max(
        _probability_of_none(logs, [weighing.log_evidence(one.fit) for one in others]),
        # parameters that a blur makes irrelevant increase the evidence, so likelihoods are compared, too
        *(_probability_of_none(*([weighing.log_likelihood(one.fit)] for one in pair)) for pair in pairs),
    )
    without = _closest(others, noise)
    shadowed = without.fit if without.setup.free_masking else None

    kept = [one for one, log in zip(ranked, logs, strict=True) if log > max(logs) - _HOPELESS]
    whole = [_in_more_slices(one, slice_step) for one in kept]
    weighing = weighing.at_most(_weighing(whole, noise))
    shares = weighing.probabilities([one.fit for one in whole])
    first = int(np.argmax(shares))
    kappa = weighing.kappa
    if kappa < 1:  # correlated misfit also increases the errors of the parameters
        whole = [one._replace(fit=one.setup.tempered(one.fit, kappa)) for one in whole]
    found = whole[first]
    averaged = tuple(
        OtherLobe(one.fit, one.setup, float(share))
        for n, (one, share) in enumerate(zip(whole, shares, strict=True))
        if n != first and share > _NEGLIGIBLE
    )
    shape = known_shape(found.fit, found.setup.spline)
    if not found.fit.has_spline:
        free = shape_uncertainty(found.fit, setup.noise, kappa)
        # a spline-modified lobe is a separate explanation
        shape = known_shape(found.fit, free.scale) if free.family_fails else free
    base = kept[first] if found.fit.has_spline else found
    return Explanation(
        located=located, setup=found.setup, candidates=[one.fit for one in whole], fit=found.fit, shape=shape,
        base=base.fit, others=averaged, refits=rig_refits(base.setup, rig, base.fit), blind_setup=blind.setup,
        blind=blind.fit, no_camera=no_camera, shadowed=shadowed, weighing=weighing,
    )  # fmt: skip


def _weighing(members: list[Member], noise: PixelNoise | None) -> Weighing:
    return Weighing.of([one.fit for one in members], noise)


def _probability_of_none(by_camera: list[float], by_none: list[float]) -> float:
    """Compute the probability of the explanations without a camera.

    The arguments are the logarithms of the evidence of the explanations with and without a camera.
    """
    difference = np.logaddexp.reduce(by_camera) - np.logaddexp.reduce(by_none)
    return float(1 / (1 + np.exp(np.clip(difference, -500, 500))))


def _closest(members: list[Member], noise: PixelNoise | None) -> Member:
    return min(members, key=lambda one: _weighing([one], noise).chi2)


def _solved(setup: FitSetup) -> Member:
    return Member(setup, setup.solve())


def _with_spline(core: Member) -> Member:
    """Fit a spline-modified lobe, with a prior from the residuals of the unmodified lobe `core`."""
    spline = min(shape_uncertainty(core.fit, core.setup.noise).scale, _WIDEST_SPLINE)
    stiff = _STIFF * core.fit.hwhm if np.isfinite(core.fit.hwhm) else 0.0
    setup = core.setup.with_(spline=spline, stiff_below=stiff)
    return Member(setup, setup.solve(start=core.fit))


def _without_camera(best: Member, rig: Rig) -> Member:
    """Fit the lobe of the explanation `best` without a camera, to the cells of `best`."""
    own = best.setup
    setup = FitSetup(
        own.tables, None, own.ndf, fresnel="free", diffuse=True, coated=own.coated, base=own.base, masking=own.masking,
        noise=own.noise, slice_step=own.slice_step, view=sample_view(rig), pixels=grid_of(rig), workspace=own.workspace,
    )  # fmt: skip
    plain = _solved(setup)
    if not own.spline:
        return plain
    modified = setup.with_(spline=own.spline, stiff_below=own.stiff_below)
    return Member(modified, modified.solve(start=plain.fit))


def with_free_masking(core: Member, rig: Rig) -> Member:
    """Fit each channel without a camera, by a spline-modified lobe with free masking.

    The family of the lobe is that of `core`.
    """
    blind = _without_camera(core._replace(setup=core.setup.with_(spline=_WIDEST_SPLINE)), rig)
    setup = blind.setup.with_(masking="smith-separable", per_channel=True, free_masking=True)
    return Member(setup, setup.solve(start=blind.fit, weights="start"))


def _in_more_slices(member: Member, slice_step: int) -> Member:
    """Fit an explanation in every `slice_step`-th slice.

    The prior of a spline modification is first estimated from the data.
    """
    if member.setup.slice_step == slice_step:
        return member
    if member.setup.spline:
        fit, setup = in_all_slices(member.fit, member.setup, slice_step)
        return Member(setup, fit)
    setup = member.setup.with_(slice_step=slice_step)
    return Member(setup, setup.solve(start=member.fit))
