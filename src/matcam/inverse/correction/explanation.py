"""Explanations of a table, weighed by their evidence (docs/correct.md).

`correct` and `fresnel` use the same explanations, so they cannot contradict each other. Every member of the list is
fitted to the same cells with F free in every slice and a Lambertian part:

- a lobe of each family through the camera, with the uncertainty of the lens (width and shape) as its prior;
- where the best of them leaves more than pixel noise: Student's t with a free tail exponent, two lobes, a lobe of each
  family over a rough base, and a spline-modified lobe;
- the best lobe as a perfect camera would have recorded it, and, where the list does not explain the data, a lobe of each
  channel with any smooth masking.

A few slices rank the members; those that may matter are fitted to more. The result is the mean over the members, by their
posterior probabilities (`evidence`).
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
from matcam.inverse.correction.evidence import OtherLobe, Weighing, noise_without_model
from matcam.inverse.correction.lobe_shape import ShapeUncertainty, known_shape, shape_uncertainty
from matcam.inverse.correction.rig_refits import RigRefit, rig_refits
from matcam.inverse.correction.spline_lobe import in_all_slices
from matcam.inverse.fit.fit_parameters import STUDENT, TWO_LOBES
from matcam.inverse.fit.fit_setup import AUTO, CANDIDATES, SEARCH_STEP, FitSetup, free_setup
from matcam.inverse.fit.material_fit import MaterialFit
from matcam.inverse.operator.pixel_phase import LocatedRig
from matcam.inverse.operator.rig_axes import LAMP, LENS, is_guess, known_lens, widths_of
from matcam.inverse.operator.sample_view import sample_view
from matcam.material.masking import Masking
from matcam.rigs import Rig

_WIDEST_SPLINE = 1.0
"""Standard deviation of the second differences of ln D at which a lobe is not bound to its family."""
_STIFF = 0.125
"""Share of the half width of a lobe below which its spline modification is stiff, because broad lobes have no finer
structure.
"""
_RANKED_STEP = 3 * SEARCH_STEP
"""Spacing of the slices in which the members are ranked."""
_SMOOTH_CORES = ("ggx", STUDENT)
"""Families that a spline modification may start from. Unlike EPD's lobe they have no cusp, which no pixel could resolve."""
_HOPELESS = 15.0
"""Difference of log evidence in the ranking slices above which a member is left out: a probability of 3e-7, which more
slices would lower further.
"""
PROBABLE = 0.95
"""Probability above which an explanation holds: of no camera, above which the data show no blur."""
_UNLIKELY = 0.05
"""Probability of no camera below which a guessed lens is used."""
_NEGLIGIBLE = 1e-3
"""Probability below which another lobe is neglected."""
UNEXPLAINED = "unexplained"
"""Code of the remark that no member of the list explains the data."""


class Member(NamedTuple):
    """One explanation of a table: a fit and its setup."""

    setup: FitSetup
    fit: MaterialFit


class Explanation(NamedTuple):
    """The explanations of a table and their probabilities.

    Attributes:
        located: the rig, with its cell rule.
        setup: setup of `fit`.
        candidates: fits of all lobes through the camera with a relevant probability.
        fit: the most probable of the candidates.
        shape: uncertainty of the shape of its lobe.
        base: fit of the same lobe in the slices of `refits`.
        others: the other lobes through the same camera, with their probabilities.
        refits: fits with one parameter of the rig free.
        blind_setup: setup of `blind`.
        blind: fit of the lobe without a camera.
        no_camera: probability of the explanations without a camera.
        shadowed: fit of a lobe of each channel with free masking, without a camera; None: the other explanations suffice.
        weighing: weights of the residuals.
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
        """Return the best fit of the table without a camera."""
        return self.shadowed or self.blind

    @property
    def no_blur(self) -> bool:
        """Check whether the data show no blur by this camera."""
        return self.no_camera > PROBABLE

    @property
    def contradicts(self) -> bool:
        """Check whether rig and data contradict each other: no blur, another lens than specified, or cells of other pixels."""
        return (
            self.located.unexplained
            or self.no_blur
            or any(refit.contradicts for refit in self.refits if refit.axis.name == LENS)
        )

    @property
    def undecided(self) -> bool:
        """Check whether the blur is unknown: the lens is a guess, and the data do not determine one."""
        camera = self.located.rig.camera
        lens = known_lens(camera).uncertainty
        if lens is None or LENS not in lens.names or self.no_camera <= _UNLIKELY:
            return False
        return is_guess(LENS, lens.std()[LENS] / float(camera.parameters()[LENS]))

    def scattering(self, lit: MaterialFit) -> MaterialFit:
        """Return the fit whose F determines the gains of the images: the one with most slices.

        A spline-modified lobe is fitted to few slices. `lit` is preferred if several fits have that number.
        """
        return max((lit, self.fit, *self.candidates), key=lambda one: one.theta_d.size)

    @property
    def no_blur_remark(self) -> Remark:
        """State that the data show no blur."""
        noise = [f"{fit.noise.relative:.1%}" for fit in (self.blind, self.fit, self.without_camera)]
        text = (
            f"the data show no blur by this camera: without it a pixel's noise would be {noise[0]}, with it {noise[1]}"
        )
        if self.shadowed is not None:
            text += f"; {noise[2]} with free shadowing and one lobe per colour"
        return Remark("no-blur-in-data", text)

    @property
    def remarks(self) -> tuple[Remark, ...]:
        """List the remarks on the explanations."""
        remarks = [*self.fit.remarks, *self.located.remarks]
        if self.fit.has_spline:
            remarks.append(self.shape.remark(self.fit.family))
        if self.weighing.known and self.weighing.unexplained:
            remarks.append(
                Remark(
                    UNEXPLAINED,
                    f"{1 - self.weighing.kappa:.0%} of the variance of the residuals is more than pixel noise "
                    f"({self.weighing.noise.relative:.1%}): no lobe of the list explains the data fully",
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
    """Build the setup that `explain` starts from.

    Args:
        brdf: a checked table, 1/sr.
        rig: the rig that recorded it, as `located_rig` returns it.
        masking: see `correct`.
        noise: see `correct`.
        workspace: see `correct`.
        slice_step: spacing of the slices that are used (no unit).
    """
    setup = free_setup([brdf], rig, masking=masking, noise=noise, slice_step=slice_step, workspace=workspace)
    refitted = tuple(name for name in (LAMP,) if name in widths_of(rig))
    return setup.with_(lens_shape=not known_lens(rig.camera).exact, refitted=refitted)


def explain(setup: FitSetup, located: LocatedRig, ndf: str) -> Explanation:
    """Fit and weigh the explanations of a table.

    Args:
        setup: its `first_setup`.
        located: the setup's rig.
        ndf: family of the lobe, or "auto".
    """
    rig, slice_step = located.rig, setup.slice_step
    families = CANDIDATES if ndf == AUTO else (ndf,)
    few = setup.with_(slice_step=max(_RANKED_STEP, slice_step))
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
        # the parameter volume that a blur hides is no evidence of the blur
        *(_probability_of_none(*([weighing.log_likelihood(one.fit)] for one in pair)) for pair in pairs),
    )
    without = _closest(others, noise)
    shadowed = without.fit if without.setup.free_masking else None

    kept = [one for one, log in zip(ranked, logs, strict=True) if log > max(logs) - _HOPELESS]
    whole = [_in_more_slices(one, slice_step) for one in kept]
    weighing = weighing.at_most(_weighing(whole, noise))
    shares = weighing.probabilities([one.fit for one in whole])
    first = int(np.argmax(shares))
    kappa = weighing.kappa if weighing.known else 1.0
    if kappa < 1:  # correlated misfit widens the errors, too
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
        # a spline-modified lobe is a member of its own
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
    """Compute the probability of no camera from log evidences of members with and without it."""
    difference = np.logaddexp.reduce(by_camera) - np.logaddexp.reduce(by_none)
    return float(1 / (1 + np.exp(np.clip(difference, -500, 500))))


def _closest(members: list[Member], noise: PixelNoise | None) -> Member:
    """Return the member with the smallest residuals."""
    return min(members, key=lambda one: _weighing([one], noise).chi2)


def _solved(setup: FitSetup) -> Member:
    return Member(setup, setup.solve())


def _with_spline(core: Member) -> Member:
    """Fit a spline-modified lobe, as free as the residuals of its family suggest."""
    spline = min(shape_uncertainty(core.fit, core.setup.noise).scale, _WIDEST_SPLINE)
    stiff = _STIFF * core.fit.hwhm if np.isfinite(core.fit.hwhm) else 0.0
    setup = core.setup.with_(spline=spline, stiff_below=stiff)
    return Member(setup, setup.solve(start=core.fit))


def _without_camera(best: Member, rig: Rig) -> Member:
    """Fit the same lobe as a perfect camera would have recorded it, in the same cells."""
    own = best.setup
    setup = FitSetup(
        own.tables, None, own.ndf, fresnel="free", diffuse=True, base=own.base, masking=own.masking, noise=own.noise,
        slice_step=own.slice_step, view=sample_view(rig), pixels=grid_of(rig), workspace=own.workspace,
    )  # fmt: skip
    plain = _solved(setup)
    if not own.spline:
        return plain
    modified = setup.with_(spline=own.spline, stiff_below=own.stiff_below)
    return Member(modified, modified.solve(start=plain.fit))


def with_free_masking(core: Member, rig: Rig) -> Member:
    """Fit free masking and a spline-modified lobe for each channel without a camera. core: fit whose family is used."""
    blind = _without_camera(core._replace(setup=core.setup.with_(spline=_WIDEST_SPLINE)), rig)
    setup = blind.setup.with_(masking="smith-separable", per_channel=True, free_masking=True)
    return Member(setup, setup.solve(start=blind.fit, weights="start"))


def _in_more_slices(member: Member, slice_step: int) -> Member:
    """Fit the same lobe in every `slice_step`-th slice; estimate the smoothness of a spline modification before."""
    if member.setup.slice_step == slice_step:
        return member
    if member.setup.spline:
        fit, setup = in_all_slices(member.fit, member.setup, slice_step)
        return Member(setup, fit)
    setup = member.setup.with_(slice_step=slice_step)
    return Member(setup, setup.solve(start=member.fit))
