"""Joint fit of merged images of a scene: priors, a starting point, and rounds of refinement.

First, the best lobe of a lattice of widths is found; for each lobe, the strengths of each image follow from linear least
squares. Then all parameters are fitted in rounds, until convergence. Before each round, the windows are placed about the
fitted highlights.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from matcam.acquisition.light.picture_light import PictureLight
from matcam.acquisition.merged_picture import MergedPicture
from matcam.core.arrays import evenly
from matcam.core.errors import ArgumentError
from matcam.core.registry import WITH_POWER
from matcam.forward.integral.blur import blur_of
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.material.diffuse_shape import TERMS
from matcam.material.masking import Masking
from matcam.material.ndf.free_lobe import KNOTS
from matcam.reconstruction.joint.field_change import FieldChange, changed_field
from matcam.reconstruction.joint.joint_fit import JointSolution, solve, summed_up
from matcam.reconstruction.joint.joint_problem import JointLayout, JointProblem, PixelModel
from matcam.reconstruction.joint.likelihood import Likelihood, likelihood_at, unexplained_share
from matcam.reconstruction.joint.rounds import is_stuck, round_line
from matcam.reconstruction.observed_pixels import ObservedPixels, chosen_pixels
from matcam.reconstruction.picture_model import LampFrame, PictureModel, lamp_frame, turned_lamp
from matcam.reconstruction.picture_rule import lamp_positions
from matcam.reconstruction.sphere_scene import SphereScene, joint_problem, mirror_ball, part_of
from matcam.rigs import Rig
from matcam.sample.curved import Sphere

_WIDTHS = np.geomspace(3e-4, 0.5, 14)
_POWERS = {"epd": (0.5, 0.8, 1.2), "sgd": (0.3, 0.8)}
_ROUGHLY, _NEARLY, _ENOUGH = 3.0, 1.0, 0.1  # decreases of the cost below which the iteration ends
_SYSTEMATIC = 0.01
"""Unexplained share above which residuals are correlated between neighbouring pixels, so that a change of the cost by
1 does not correspond to one standard deviation.
"""
_HOPELESS = 20.0
"""Mean squared residual of an image, absolute and relative to other images, above which the image is unexplained."""


Observe = Callable[..., tuple[PixelModel, list[ObservedPixels], list[FieldChange]]]
"""Function that chooses the pixels and the model for a kind of sample, with the interface of `sphere_pixels`."""


@dataclass(frozen=True)
class SphereFit:
    """Joint fit of the images of a sphere, or of another sample with the same parameters.

    Attributes:
        scene: prior knowledge.
        kind: family, masking and splines of the lobe.
        solution: parameters and covariance.
        channels: names of the colours.
        names: names of the images.
        stuck: unexplained share after each round, if the rounds were ended because the share did not decrease. Default: ().
    """

    scene: SphereScene
    kind: LobeKind
    solution: JointSolution
    channels: tuple[str, ...]
    names: tuple[str, ...]
    stuck: tuple[float, ...] = ()

    @property
    def layout(self) -> JointLayout:
        return self.solution.problem.layout

    @property
    def lamps(self) -> np.ndarray:
        """Fitted directions to the lamps, (pictures, 3)."""
        problem, p = self.solution.problem, self.solution.p
        return np.array([np.asarray(turned_lamp(f, *p[problem.layout.turn(k)])) for k, f in enumerate(problem.frames)])

    @property
    def nearness(self) -> float:
        """Inverse distance of the lamp, 1/radii."""
        return float(self.solution.p[self.layout.of("lamp")])

    @property
    def strengths(self) -> np.ndarray:
        """Strength of the lobe in each image and channel, (pictures, channels)."""
        return np.array([self.solution.p[self.layout.strengths(k)] for k in range(self.layout.pictures)])

    @property
    def unexplained_pictures(self) -> tuple[int, ...]:
        """Indices of the images that the fit does not explain, although it explains others."""
        chi2 = self.solution.chi2
        return tuple(np.flatnonzero((chi2 > _HOPELESS) & (chi2 > _HOPELESS * np.median(chi2))).tolist())

    @property
    def strengths_std(self) -> np.ndarray:
        """Standard deviation of `strengths`, (pictures, channels)."""
        return np.sqrt(np.maximum(np.diag(self.strengths_covariance()), 0)).reshape(self.strengths.shape)

    @property
    def light(self) -> PictureLight:
        """Light of the images, and the unit of their values, at the fitted positions of the lamps."""
        return self.scene.light_at(self.lamps, self.nearness)

    def strengths_covariance(self, covariance: np.ndarray | None = None) -> np.ndarray:
        """Compute the covariance of the strengths at fixed angles theta_d, (pictures x channels, pictures x channels).

        The uncertainty of the angle of each image is included. It contributes the slope of F times the error of the angle,
        with all correlations. The same applies to the change of the unit of the values with the distance of the lamp.

        Args:
            covariance: covariance of all parameters. Default: None, that of the fit.
        """
        rows = self.strengths_rows()
        return rows @ (self.solution.covariance if covariance is None else covariance) @ rows.T

    def strengths_rows(self) -> np.ndarray:
        """Compute the derivatives of the strengths at fixed angles theta_d and a fixed unit with respect to all parameters.

        The result has the shape (pictures x channels, size).
        """
        layout, solution, strengths = self.layout, self.solution, self.strengths
        by_nearness = self.light.unit_by_nearness
        rows = np.zeros((layout.pictures * layout.channels, layout.size))
        for k in range(layout.pictures):
            for c in range(layout.channels):
                row = rows[k * layout.channels + c]
                row[layout.strengths(k).start + c] = 1.0
                # F at the fixed angle = F at the fitted angle less slope times the error of the angle
                row -= strengths[k, c] * solution.problem.slope[k, c] * solution.theta_d_slope[k]
                row[layout.of("lamp")] -= strengths[k, c] * by_nearness
        return rows


def fit_sphere(
    pictures: Sequence[MergedPicture],
    scene: SphereScene,
    family: str,
    *,
    masking: Masking,
    diffuse: bool,
    lamps: np.ndarray,
    progress: Callable[[str], None],
    spline: float = 0.0,
    start: SphereFit | None = None,
    rounds: int = 4,
    observe: Observe | None = None,
    stretched: bool = False,
    rivals: Sequence[str] = (),
    shaped: bool = False,
) -> SphereFit:
    """Fit lobe, strengths, lens, outline, lamps and distances to all images of a sphere, or of another sample.

    Args:
        pictures: merged images, one per lamp position.
        scene: prior knowledge of the scene.
        family: family of the lobe.
        masking: model of the masking of the lobe.
        diffuse: True to include a Lambertian part.
        lamps: unit vectors to the lamps with which the search starts, (pictures, 3).
        progress: function that is called with a line about each round.
        spline: prior standard deviation of the departure of ln D from its family (no unit). Default: 0, no departure.
        start: earlier fit of all or some of these images, with any lobe, from which this fit starts. Default: None, a search.
        rounds: largest number of rounds of refinement. Default: 4.
        observe: function that chooses pixels and model for a sample other than a sphere. Default: None, a sphere.
        stretched: True for a lobe with two roughnesses, "ggx" only. Default: False.
        shaped: True if the diffuse part of a sphere may depart from Lambert's law. Default: False.
        rivals: other families for a search without `start`. The family with the smallest cost in the search is fitted.
            Default: ().

    Raises:
        ArgumentError: there are fewer than 2 images.
        FitError: a fitted parameter is not finite.
    """
    if len(pictures) < 2:
        raise ArgumentError(f"a joint fit needs at least 2 images, got {len(pictures)}: add images")
    again = observe is None
    observe = observe or sphere_pixels
    kind = LobeKind(family, masking, KNOTS if spline else 0, stretched=stretched)
    channels = pictures[0].channels
    known = replace(scene, lamps=lamps)
    if start is None:
        cost, lobe = _searched(pictures, known, kind, _WIDTHS, observe)
        if rivals:  # families are compared at their best widths
            # relative widths of the second search
            between = _searched(pictures, known, kind, np.exp(lobe[0]) * np.array([0.75, 1.33]), observe)
            cost, lobe = min((cost, lobe), between, key=lambda one: one[0])
        for rival in rivals:
            other = LobeKind(rival, masking, kind.spline_size)
            least, found_lobe = _searched(pictures, known, other, _WIDTHS, observe)
            if least < cost:
                cost, lobe, kind = least, found_lobe, other
        progress(f"start: {kind.family} of width {np.exp(lobe[0]):.4g}")
    layout = JointLayout(kind.size, len(channels), len(pictures), TERMS if shaped else 0)
    p = np.zeros(layout.size)
    _write_scene(p, layout, scene)
    if start is None:
        p[: lobe.size] = lobe
    else:
        old, q = start.layout, start.solution.p
        p[: layout.shared] = layout.shared_of(q, old)
        directions = known.lamps.copy()
        for k, one in enumerate(pictures):
            if one.name in start.names:
                j = start.names.index(one.name)
                p[layout.own(k).start : layout.strengths(k).stop] = q[old.own(j).start : old.strengths(j).stop]
                directions[k] = start.lamps[j]
            p[layout.turn(k)] = 0.0
        known = replace(scene, lamps=directions)
    slope: np.ndarray | None = None
    likelihood, solution = Likelihood(0.02), None
    shares, started = list[float](), time.monotonic()
    best: SphereFit | None = None
    for turn in range(rounds):
        progress(round_line(shares, rounds, len(pictures), time.monotonic() - started))
        last = None if solution is None else solution.problem.pixels
        frames = [lamp_frame(one) for one in known.lamps]
        chosen = observe(pictures, scene, frames, layout, kind, p, keep=last)
        problem = joint_problem(
            layout,
            kind,
            scene,
            frames,
            *chosen,
            slope=slope,
            diffuse=diffuse,
            spline=spline,
            nearness=float(p[layout.of("lamp")]),
        )
        p = p.copy()  # the previous round may be returned
        for k in range(layout.pictures):
            p[layout.turn(k)] = 0.0
        if turn == 0:
            p = _with_strengths(problem, p, likelihood.share)
            p[layout.diffuse] *= diffuse
        before = p.copy()
        # the windows of the first round are placed again
        rough = rounds > 1 if turn == 0 else likelihood.share > _SYSTEMATIC
        p = solve(problem, p, likelihood, _ROUGHLY if rough else _ENOUGH)
        share = unexplained_share(problem, p)
        settled = abs(share - likelihood.share) < 0.05 * likelihood.share + 1e-4
        likelihood = Likelihood(share)
        solution = summed_up(problem, p, likelihood)
        found = SphereFit(scene, kind, solution, channels, tuple(one.name for one in pictures))
        lamps_now = _lamps_again(found, pictures) if again else found.lamps
        known, slope = replace(scene, lamps=lamps_now), _slopes(found)
        shares.append(share)
        if is_stuck(shares) and best is not None:
            return replace(best, stuck=tuple(shares))
        best = found if best is None or likelihood.share < best.solution.unexplained else best
        std = np.sqrt(np.maximum(np.diag(solution.covariance), 1e-30))
        if (
            turn
            and settled
            and not found.unexplained_pictures
            and np.all(np.abs(p - before)[: layout.shared] < 0.2 * std[: layout.shared])
        ):
            break
    return found


def with_correlated_residuals(fit: SphereFit) -> SphereFit:
    """Refine a fit with weights that take the correlation of residuals between pixels into account.

    A search must not start with these weights, because far from the optimum all residuals are correlated and the search
    would not converge.
    """
    problem, p = fit.solution.problem, fit.solution.p
    likelihood = likelihood_at(problem, p)
    if likelihood.share == 0:
        return fit
    p = solve(problem, p, likelihood, _NEARLY if likelihood.share > _SYSTEMATIC else _ENOUGH)
    return replace(fit, solution=summed_up(problem, p, likelihood))


def _write_scene(p: np.ndarray, layout: JointLayout, scene: SphereScene) -> None:
    light = scene.light_at(scene.lamps, scene.lamp_nearness.value)
    p[layout.scene] = [0.0, scene.radius, scene.camera_nearness.value, scene.lamp_nearness.value]
    for k in range(layout.pictures):
        p[layout.own(k)] = [*scene.centres[k], 0.0, 0.0]
        p[layout.gain(k)] = np.log(light.gain[k])


def _searched(
    pictures: Sequence[MergedPicture],
    scene: SphereScene,
    kind: LobeKind,
    widths: np.ndarray,
    observe: Observe,
) -> tuple[float, np.ndarray]:
    """Find the lobe of a lattice that fits a few images best. The strengths are fitted for each lobe.

    Returns:
        Cost and coordinates of the lobe.
    """
    # number of images in the search for the lobe
    few = evenly(len(pictures), 6)
    some = [pictures[k] for k in few]
    part = part_of(scene, few.tolist())
    layout = JointLayout(kind.size, len(pictures[0].channels), len(some))
    best: tuple[float, np.ndarray] | None = None
    for lobe in _lattice(kind, widths):
        p = np.zeros(layout.size)
        p[: len(lobe)] = np.log(lobe)
        _write_scene(p, layout, part)
        frames = [lamp_frame(one) for one in part.lamps]
        problem = joint_problem(layout, kind, part, frames, *observe(some, part, frames, layout, kind, p, disc=False))
        p = _with_strengths(problem, p, 0.05)
        judge = Likelihood(0.05)
        cost = sum(
            judge.cost(problem.pixels[k], problem.picture(p, k, slopes=False).value) for k in range(layout.pictures)
        )
        if best is None or cost < best[0]:
            best = cost, p[: kind.size].copy()
    assert best is not None
    return best


def _lattice(kind: LobeKind, widths: np.ndarray) -> list[tuple[float, ...]]:
    if kind.stretched:
        return [(along, across) for along in widths[::2] for across in widths[::2]]
    if kind.family in WITH_POWER:
        return [(width, power) for width in widths for power in _POWERS[kind.family]]
    return [(width,) for width in widths]


def _with_strengths(problem: JointProblem, p: np.ndarray, unexplained: float) -> np.ndarray:
    """Fit strengths and diffuse parts by linear least squares, image by image.

    The diffuse part of each channel is the median over the images. unexplained: noise of a pixel in addition to its
    standard deviation, as a share of its value.
    """
    layout, p = problem.layout, p.copy()
    diffuse = np.zeros((layout.pictures, layout.channels))
    for k in range(layout.pictures):
        pixels = problem.pixels[k]
        recorded, _ = problem.recorded(p, k, slopes=False)
        for c in range(layout.channels):
            of = pixels.used & (pixels.channel == c) & ~pixels.clipped
            columns = np.column_stack([recorded.lobe[of], recorded.lambert[of]])
            values, std = pixels.values[of], np.hypot(pixels.std[of], unexplained * np.abs(pixels.values[of]))
            if values.size < 10:
                continue
            strength, one = 0.0, 0.0
            weight = 1 / std
            for _ in range(4):
                strength, one = np.linalg.lstsq(columns * weight[:, None], values * weight, rcond=None)[0]
                u = np.abs(values - columns @ [strength, one]) / std
                weight = np.sqrt(np.where(u > 4, 4 / np.maximum(u, 4), 1.0)) / std
            p[layout.strengths(k).start + c], diffuse[k, c] = strength, one
    p[layout.diffuse] = np.median(diffuse, axis=0)
    return np.clip(p, problem.low, problem.high)


def sphere_pixels(
    pictures: Sequence[MergedPicture],
    scene: SphereScene,
    frames: Sequence[LampFrame],
    layout: JointLayout,
    kind: LobeKind,
    p: np.ndarray,
    *,
    disc: bool = True,
    keep: Sequence[ObservedPixels] | None = None,
) -> tuple[PixelModel, list[ObservedPixels], list[FieldChange]]:
    """Choose the pixels of a sphere for the fit, and build their model.

    The windows are about the highlights that follow from the parameters p.

    Args:
        pictures: merged images.
        scene: prior knowledge of the scene.
        frames: base direction of the lamp of each image.
        layout: order of the parameters.
        kind: family, masking and splines of the lobe.
        p: parameters, (size,).
        disc: False to treat the lamp as a point. Default: True.
        keep: earlier choice of the pixels of each image, which is kept if the window has not moved. Default: None.

    Returns:
        Model of the pixels, pixels of each image, and effect of a change of the lens field on each image. The latter list
        is empty if the scene has no lens field.
    """
    width = float(np.exp(p[0]))
    turns, weights, plateau = lamp_positions(scene.lamp_radius if disc else 0.0, width)
    blur = blur_of(Rig(scene.camera, Sphere(scene.radius)))
    pixels, changes = [], list[FieldChange]()
    known_field = scene.camera.field
    field = None if known_field is None else changed_field(known_field, p[layout.field])
    for k, picture in enumerate(pictures):
        ball, far = mirror_ball(layout, p, k)
        row, column = ball.mirror_position(frames[k].base, far)
        at = float(column), float(row)
        last = None if keep is None else keep[k]
        pixels.append(
            chosen_pixels(
                picture, ball, frames[k].base, at, scale=width / 3, plateau=plateau, seed=k, keep=last, field=field
            )
        )
        if scene.field is not None:
            changes.append(FieldChange(scene.field, at, pixels[-1].seen))
    return PictureModel(kind, blur, turns, weights), pixels, changes


def _lamps_again(fit: SphereFit, pictures: Sequence[MergedPicture]) -> np.ndarray:
    """Choose the directions to the lamps for the next round.

    The fitted directions are used, except for unexplained images. In those, the brightest pixel determines the direction.
    """
    lamps = fit.lamps
    for k in fit.unexplained_pictures:
        ball, far = mirror_ball(fit.layout, fit.solution.p, k)
        picture = pictures[k]
        rows, columns = np.indices(picture.values.shape) + np.array(picture.origin)[:, None, None]
        if fit.scene.camera.field is not None:
            columns, rows = fit.scene.camera.field.true_position(columns, rows)
        away = np.hypot(rows - ball.row, columns - ball.column)
        light = np.where(np.isfinite(picture.values) & (away < ball.radius - 0.5), picture.values, -np.inf)
        at = np.unravel_index(int(np.argmax(light)), light.shape)
        normal = ball.normals(rows[at], columns[at])
        if np.all(np.isfinite(normal)):
            lamps[k] = ball.lamp_seen_at(normal, far)
    return lamps


def _slopes(fit: SphereFit) -> np.ndarray:
    """Estimate d ln F / d theta_d of each image and channel, 1/rad, from a smooth curve through the strengths."""
    theta, strengths = fit.solution.theta_d, fit.strengths
    slope = np.zeros_like(strengths)
    if len(theta) < 5:
        return slope
    covariance = fit.strengths_covariance()
    std = np.sqrt(np.maximum(np.diag(covariance), 1e-30)).reshape(strengths.shape)
    # these powers of 1 - cos, with Schlick's fifth, approximate F of metals and dielectrics to one per cent
    c = 1 - np.cos(theta)
    basis = np.column_stack([np.ones_like(c), c, c**5, c**9])
    by_theta = np.column_stack([np.zeros_like(c), np.sin(theta), 5 * c**4 * np.sin(theta), 9 * c**8 * np.sin(theta)])
    for channel in range(strengths.shape[1]):
        f = strengths[:, channel]
        weight = 1 / np.hypot(std[:, channel], 0.01 * np.abs(f) + 1e-12)
        coefficients = np.linalg.lstsq(basis * weight[:, None], f * weight, rcond=None)[0]
        value = basis @ coefficients
        good = value > 0.2 * np.abs(f).mean()
        slope[:, channel] = np.where(good, by_theta @ coefficients / np.where(good, value, 1.0), 0.0)
    return np.clip(slope, -5, 20)
