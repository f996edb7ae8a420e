"""What explains a table best: a lobe through the rig's camera, bent or not, or no camera at all (docs/correct.md).

`correct` and `fresnel` read the same explanation, so they cannot contradict each other. Everything is fitted to the same
cells with F free in every slice and a Lambertian part.

- The camera: its lens as the profile states it or as assumed, the shape of the lens's kernel uncertain, too.
- Where no family explains the data Student's t may, whose tails are of any length; and then two lobes: a coat over a base,
  facets of two finishes.
- A lobe that fails, too, is bent, where that explains the noise. Elsewhere what bending would change is uncertainty. What
  Student's t or two lobes in place of the bent one would change is uncertainty as far as they are probable.
- No camera: the same lobe as a perfect camera would have recorded it. If it makes the data clearly more probable, the data
  show no blur by this camera, whatever the rig says.
- Shadowing: where no lobe explains the noise, neither with a camera nor without, each colour has a lobe of its own, and masking
  is any smooth function of the angle. Of F it says nothing, but whether there is a camera, and what a pixel's noise is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

from matcam.camera.sensor import PixelNoise
from matcam.core.remark import Remark
from matcam.core.workspace import Workspace
from matcam.forward.pixel_grid import grid_of
from matcam.inverse.correction.bent_lobe import in_all_slices
from matcam.inverse.correction.doubts import (
    Doubt,
    OtherLobe,
    ShapeCorrection,
    no_correction,
    rig_doubts,
    shape_correction,
)
from matcam.inverse.correction.other_maskings import EVIDENCE
from matcam.inverse.fit.fit_parameters import STUDENT, TWO_LOBES
from matcam.inverse.fit.fit_setup import AUTO, SEARCH_EVERY, FitSetup, candidate_fits, free_setup, likeliest
from matcam.inverse.fit.material_fit import MaterialFit
from matcam.inverse.operator.pixel_phase import LocatedRig
from matcam.inverse.operator.rig_axes import LAMP, LENS, is_guess, known_lens, widths_of
from matcam.inverse.operator.sample_view import sample_view
from matcam.material.masking import Masking
from matcam.rigs import Rig

_MOST_BEND = 1.0
"""How far a lobe whose family fails may leave it at most (`fit`, bend): as far as the data ask, up to this."""
_STIFF = 0.125
"""Share of a lobe's half width below which a bend is stiff: a broad lobe has no fine structure."""
_BEND_EVERY = 3 * SEARCH_EVERY
_SMOOTH_CORE = "ggx"
"""Family that is bent if it was tried: unlike EPD's it has no cusp, of which no pixel could say whether it is there. Student's
t, which has none either, is bent where it asks for less."""
_MOST_NOISE = 0.05
"""Noise of a pixel, estimated, up to which a lobe explains its data."""
_MOST_MISFIT = 2.0
"""Misfit up to which a lobe explains its data, where the noise was given."""
_PROBABLE = 0.5
"""Probability from which something is taken to be so."""
_UNLIKELY = 0.05
"""Probability of no camera down to which a lens that is a guess moves nothing."""
_NEGLIGIBLE = 1e-3
"""Probability below which another lobe counts for nothing."""


class Explanation(NamedTuple):
    """Hold the fits of a table and what they say together.

    Attributes:
        located: the rig, which says what cells stand for.
        setup: of `fit`.
        candidates: fits of each family through the camera.
        fit: the lobe through the camera that explains the data best.
        shape: what is changed of its shape.
        base: the same lobe in those slices that doubts are fitted to: they differ from it.
        others: other lobes through the same camera, whose difference is uncertainty.
        doubts: fits with a parameter of the rig free.
        blind_setup: of `blind`.
        blind: the lobe without a camera.
        no_camera: probability that no camera, rather than this one, made the table.
        shadowed: a lobe of each colour with free masking, without a camera; None where nothing asks for it.
    """

    located: LocatedRig
    setup: FitSetup
    candidates: list[MaterialFit]
    fit: MaterialFit
    shape: ShapeCorrection
    base: MaterialFit
    others: tuple[OtherLobe, ...]
    doubts: tuple[Doubt, ...]
    blind_setup: FitSetup
    blind: MaterialFit
    no_camera: float
    shadowed: MaterialFit | None

    @property
    def without_camera(self) -> MaterialFit:
        """Return what explains the table best if no camera is needed."""
        return self.shadowed or self.blind

    @property
    def no_blur(self) -> bool:
        """Say whether the data show no blur by this camera."""
        return self.no_camera > _PROBABLE

    @property
    def contradicts(self) -> bool:
        """Say whether rig and data contradict each other: no blur, another lens than is stated, or cells of other pixels."""
        return (
            self.located.unexplained
            or self.no_blur
            or any(doubt.contradicts for doubt in self.doubts if doubt.axis.name == LENS)
        )

    @property
    def undecided(self) -> bool:
        """Say whether nobody knows of a blur: the lens is a guess, and the data do not show one clearly."""
        camera = self.located.rig.camera
        lens = known_lens(camera).uncertainty
        if lens is None or LENS not in lens.names or self.no_camera <= _UNLIKELY:
            return False
        return is_guess(LENS, lens.std()[LENS] / float(camera.parameters()[LENS]))

    def scattering(self, lit: MaterialFit) -> MaterialFit:
        """Return the fit whose F shows the pictures' gains: one that has most slices. A bent lobe is fitted in a few.

        lit: preferred, if it has as many.
        """
        return max((lit, self.fit, *self.candidates), key=lambda one: one.theta_d.size)

    @property
    def no_blur_remark(self) -> Remark:
        """Say that the data show no blur."""
        noise = [f"{fit.noise.relative:.1%}" for fit in (self.blind, self.fit, self.without_camera)]
        text = (
            f"the data show no blur by this camera: without it a pixel's noise would be {noise[0]}, with it {noise[1]}"
        )
        if self.shadowed is not None:
            text += f"; {noise[2]} with free shadowing and a lobe for each colour"
        return Remark("no-blur-in-data", text)

    @property
    def remarks(self) -> tuple[Remark, ...]:
        """Say what a reader should know of it."""
        remarks = [*self.fit.remarks, *self.located.remarks]
        if self.shape.family_fails:
            remarks.append(self.shape.remark(self.fit.family, bent=self.fit.is_bent))
        return (*remarks, *(doubt.remark for doubt in self.doubts if doubt.contradicts))


def first_setup(
    brdf: xr.DataArray,
    rig: Rig,
    *,
    masking: Masking,
    noise: PixelNoise | None,
    workspace: Workspace | None,
    every: int = SEARCH_EVERY,
) -> FitSetup:
    """Return the setup that `explain` begins with.

    Args:
        brdf: a checked table, 1/sr.
        rig: the rig that recorded it, as `located_rig` returns it.
        masking: as of `correct`.
        noise: as of `correct`.
        workspace: as of `correct`.
        every: spacing of the slices that are used (no unit).
    """
    setup = free_setup([brdf], rig, masking=masking, noise=noise, every=every, workspace=workspace)
    doubted = tuple(name for name in (LAMP,) if name in widths_of(rig))
    return setup.with_(lens_shape=not known_lens(rig.camera).exact, doubted=doubted)


def explain(setup: FitSetup, located: LocatedRig, ndf: str) -> Explanation:
    """Return the explanation of a table.

    Args:
        setup: its `first_setup`.
        located: the setup's rig.
        ndf: family of the lobe, or "auto".
    """
    rig, noise, every = located.rig, setup.noise, setup.every
    candidates = candidate_fits(setup, ndf)
    found = likeliest(candidates)
    setup = setup.with_(ndf=found.family)
    blind_setup = FitSetup(
        setup.tables, None, found.family, fresnel="free", diffuse=True, masking=setup.masking, noise=noise, every=every,
        view=sample_view(rig), pixels=grid_of(rig), workspace=setup.workspace,
    )  # fmt: skip
    shape = shape_correction(found, noise)
    refused: list[OtherLobe] = []
    smooth, bend = next((one for one in candidates if one.family == _SMOOTH_CORE), found), shape.scale
    for name in (STUDENT, TWO_LOBES) if shape.family_fails and ndf == AUTO else ():
        few_of_it = _few_slices(setup.with_(ndf=name))
        asked = shape_correction(few_of_it.fit, noise)  # it refuses most tables that fail
        if not asked.family_fails:
            whole = setup.with_(ndf=name).solve(start=few_of_it.fit)
            asked = shape_correction(whole, noise)
            likelier = whole.log_likelihood > found.log_likelihood
            # free in two widths and a share, they bend to a lens that is wrong: what is left then is no pixel's noise
            if likelier and _explains(whole, noise) and not asked.family_fails:
                found, shape, candidates = whole, asked, [*candidates, whole]
                setup, blind_setup = setup.with_(ndf=name), blind_setup.with_(ndf=name)
                break
        refused.append(few_of_it)
        if name == STUDENT and asked.scale < bend:
            smooth, bend = few_of_it.fit, asked.scale
    others: tuple[OtherLobe, ...] = ()
    base, base_setup = found, setup
    if not shape.family_fails:
        blind, through_camera = blind_setup.solve(), found
    else:
        few = setup.with_(every=max(_BEND_EVERY, every))
        bend = min(bend, _MOST_BEND)
        stiff = _STIFF * smooth.hwhm if np.isfinite(smooth.hwhm) else 0.0
        bent_setup = few.with_(bend=bend, stiff_below=stiff, ndf=smooth.family)
        through_camera = bent_setup.solve(start=smooth)
        blind_setup = blind_setup.with_(every=few.every, ndf=smooth.family)
        plain = blind_setup.solve()
        blind_setup = blind_setup.with_(bend=bend, stiff_below=stiff)
        blind = blind_setup.solve(start=plain)
        if _explains(through_camera, noise):
            base, base_setup = through_camera, bent_setup
            found, setup = in_all_slices(through_camera, bent_setup, every)
            shape = no_correction(found, shape.scale)
            rivals = [_whole(other, every) for other in _as_probable(refused, through_camera)]
            others = _as_probable(rivals, found)
        else:
            others, shape = (OtherLobe(through_camera, bent_setup, 1.0),), no_correction(found, shape.scale)
    no_camera = _probability(blind, through_camera)
    shadowed = None
    if not _explains(blind, noise) and (no_camera > _PROBABLE or not _explains(through_camera, noise)):
        shadowed = _shadowed(blind_setup, blind)
    if shadowed is not None and not _explains(through_camera, noise):
        no_camera = max(no_camera, _probability(shadowed, through_camera))
    doubts = rig_doubts(base_setup, rig, base)
    return Explanation(
        located, setup, candidates, found, shape, base, others, doubts, blind_setup, blind, no_camera, shadowed
    )


def _few_slices(setup: FitSetup) -> OtherLobe:
    """Return the fit of a lobe to a few slices."""
    few = setup.with_(every=max(_BEND_EVERY, setup.every))
    return OtherLobe(few.solve(), few, 1.0)


def _whole(other: OtherLobe, every: int) -> OtherLobe:
    """Return a lobe that was fitted to a few slices in every `every`-th."""
    setup = other.setup.with_(every=every)
    return other._replace(fit=setup.solve(start=other.fit), setup=setup)


def _as_probable(others: Sequence[OtherLobe], found: MaterialFit) -> tuple[OtherLobe, ...]:
    """Weigh other lobes by their probabilities, of all and the one that is corrected for; all are fits of the same slices."""
    if not others:
        return ()
    odds = EVIDENCE * np.array([0.0, *(other.fit.log_likelihood - found.log_likelihood for other in others)])
    shares = np.exp(odds - odds.max())
    shares = shares[1:] / shares.sum()
    pairs = zip(others, shares, strict=True)
    return tuple(other._replace(weight=float(np.sqrt(share))) for other, share in pairs if share > _NEGLIGIBLE)


def _shadowed(blind_setup: FitSetup, blind: MaterialFit) -> MaterialFit | None:
    """Return the fit with free masking and a lobe for each colour, if it makes the data clearly more probable."""
    setup = blind_setup.with_(masking="smith-separable", per_channel=True, free_masking=True, bend=_MOST_BEND)
    found = setup.solve(start=blind, weights="start")
    return found if _probability(found, blind) > _PROBABLE else None


def _probability(one: MaterialFit, other: MaterialFit) -> float:
    """Return the probability of one explanation of some cells against another; parameters of free masking count (Akaike)."""
    difference = EVIDENCE * (one.log_likelihood - other.log_likelihood)
    if one.coordinates.kind.shadows:
        difference -= one.effective_parameters() - other.effective_parameters()
    return float(1 / (1 + np.exp(-np.clip(difference, -500, 500))))


def _explains(found: MaterialFit, noise: PixelNoise | None) -> bool:
    """Say whether a fit leaves no more than a pixel's noise."""
    if noise is not None:
        return found.misfit < _MOST_MISFIT
    return max(found.noise.relative, 20 * found.noise.floor) < _MOST_NOISE
