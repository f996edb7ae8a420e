"""Traces of processing in an image of an edge, and their effect on an MTF.

A lens cannot be measured in a denoised image, but the processing causes traces: in the noise of the flat sides
(`flat_noise.py`), in values that many pixels share, and in an overshoot. Each trace is reported with its possible effect
on the MTF. The effect increases the standard deviations. It is modelled as an unknown relative scale of frequency, which
does not change the MTF of 1 at frequency 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.special import ndtr, ndtri

from matcam.calibration.edge.edge_result import EdgeMTF, EdgeStack
from matcam.calibration.edge.free_curve import Ghost, edge_response, ghost_of, line_width
from matcam.calibration.edge.free_fit import VEIL
from matcam.calibration.edge.rows import CLEAR, SHARPENED, EdgeRegions
from matcam.calibration.edge.wider_errors import widened, with_core_as_total, with_ghosts
from matcam.calibration.photograph.flat_noise import (
    LEAST_NOISE,
    TONE_CURVE_UNCERTAINTY,
    FlatNoise,
    crushed_share,
    flat_noise,
    smoothing_uncertainty,
)
from matcam.calibration.photograph.linear_filters import (
    AMOUNT,
    Correlations,
    correlations,
    edge_gain,
    effect_on_half,
    filter_uncertainty,
    mask_gain,
    needed_gain,
)
from matcam.calibration.photograph.uneven_light import GhostShare, LightField
from matcam.core.arrays import FloatArray
from matcam.core.remark import Remark
from matcam.numerics.crossing import first_fall
from matcam.numerics.normal import SIGNIFICANT

_LEAST_REPORTED = 1e-3
"""Smallest relative error of MTF50 that is reported."""
_GHOST = 0.01
"""Height relative to the step above which a ghost is reported."""


class Trace(NamedTuple):
    """Trace of image processing or uneven light, and its effect on the MTF.

    Attributes:
        share: relative standard deviation of MTF50 that the trace causes.
        remark: description of the trace; None if it is too small to be reported.
        of: affected estimates: "lens" for all, "free" for the model-free estimates, "glare" for the estimates with glare.
    """

    share: float
    remark: Remark | None = None
    of: str = "lens"


@dataclass(frozen=True, eq=False)
class _EdgeRegion:
    """Measured edge with its pixels.

    Attributes:
        edge: result of the measurement.
        value: (rows, columns) values corrected for uneven light; NaN for missing pixels.
        distance: (rows, columns) distances from the edge, px.
        mosaic: whether the pixels are the sites of one colour of a mosaic.
        clear: distance of the edge from the borders, in standard deviations of its blur.
        light: uneven light; None if it was not estimated, or a polynomial of third order explains it.
    """

    edge: EdgeMTF
    value: FloatArray
    distance: FloatArray
    mosaic: bool
    clear: float
    light: LightField | None

    @cached_property
    def blur(self) -> float:
        """Standard deviation of the line spread function, px."""
        return float(line_width(self.edge.fits.free.shape))

    @cached_property
    def ghost(self) -> Ghost:
        return ghost_of(self.edge.fits.free)

    @cached_property
    def sides(self) -> tuple[np.ndarray, np.ndarray]:
        # A side is assumed to be flat beyond 3 standard deviations of the blur plus 2 px from the edge and from its ghost.
        there, margin = np.isfinite(self.value), 3.0 * self.blur + 2.0
        if self.ghost.share:
            position = self.ghost.position * (1 if self.ghost.bright else -1)
            there = there & (np.abs(self.distance - position) > margin)
        return there & (self.distance < -margin), there & (self.distance > margin)

    @cached_property
    def levels(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Distinct values of each flat side in ascending order, and the number of pixels with each value."""
        return [np.unique(self.value[side], return_counts=True) for side in self.sides]

    @cached_property
    def noise(self) -> FlatNoise:
        least = LEAST_NOISE * abs(self.edge.bright - self.edge.dark)
        return flat_noise(self.value, *self.sides, lines=not self.mosaic, least=least)

    @cached_property
    def correlations(self) -> Correlations | None:
        """Correlations of the noise; None if they are unknown.

        They are also None for a mosaic, which is assumed to be unfiltered.
        """
        if self.mosaic or not np.isfinite(self.noise.neighbour_ratio_std):
            return None
        return correlations(np.where(np.isfinite(self.value), self.value, 0.0), self.sides)

    def traces(self) -> list[Trace]:
        smoothed = _smoothed(self)
        raised = []
        if self.clear > CLEAR:
            raised = _sharpened(self) or _slightly_sharpened(self)
        filtered = [] if self.noise.compressed else _filtered(self, smoothed, raised)
        coarse = _coarse(self)
        toned = _tone_curve(self) or ([] if any(trace.remark for trace in coarse) else _asymmetric(self))
        # The error per step of the light was measured with the penumbrae and glints of tests/oracle.
        lit = [] if self.light is None else [Trace(2.5 * self.light.unknown)]
        found = [*smoothed, *raised, *filtered, *_crushed(self), *coarse, *toned, *lit]
        return [*found, *_narrow(self), *_veiled(self), *_ghost(self)]


def with_traces(
    stack: EdgeStack, regions: Iterable[EdgeRegions], lights: Sequence[LightField | None], clear: np.ndarray
) -> EdgeStack:
    """Add remarks and uncertainties from uneven light and processing to a stack.

    If glare and uneven light cannot be distinguished, the MTF is that of the lens without glare. `stack`: results of n
    edges. `regions`: rows of these edges, corrected for uneven light. `lights`: uneven light of each edge, or None. `clear`:
    `clearance` of each edge (n,).
    """
    shares = {of: np.zeros(len(stack)) for of in ("lens", "free", "glare")}
    given = list(stack.given or [()] * len(stack))
    of_edges = ((rows, k) for rows in regions for k in range(len(rows.value)))
    for i, (rows, k) in enumerate(of_edges):
        if stack.problems[i] is None:
            edge = stack[i]
            distance = rows.distances(k, edge.fits.curve, edge.fits.length)
            found = _EdgeRegion(edge, rows.value[k], distance, rows.step > 1, float(clear[i]), lights[i]).traces()
            given[i] = given[i] + tuple(trace.remark for trace in found if trace.remark)
            for trace in found:
                shares[trace.of][i] = np.hypot(shares[trace.of][i], trace.share)
    # A lens model determines the tails. Its errors are therefore a tenth of those of the model-free estimate.
    shares["lens"] = np.hypot(shares["lens"], 0.1 * shares["free"])
    removed = np.array([light is not None and light.amplitude > 0 for light in lights])
    ghosts = [GhostShare() if light is None else light.ghost for light in lights]
    stack = with_core_as_total(replace(stack, given=tuple(given)), removed)
    # Light that was removed may include a ghost, which is included in the MTF again.
    included = np.where(removed, [one.share for one in ghosts], 0.0)
    stack = with_ghosts(stack, included, np.array([one.position for one in ghosts]))
    share_stds = np.where(removed, [one.std for one in ghosts], [one.rms for one in ghosts])
    return widened(stack, shares, share_stds, included * [one.position_std for one in ghosts])


def _narrow(region: _EdgeRegion) -> list[Trace]:
    """Estimate the error of the model-free MTF50 if the blur extends to the border of the region."""
    # The error is at most 8 % of MTF50, and decreases to 0 over 0.6 blur widths.
    share = 0.08 * float(np.clip((CLEAR - region.clear) / 0.6, 0.0, 1.0))
    if not share:
        return []
    text = (
        f"the border of the region is only {region.clear:.1f} blur widths of {region.blur:.1f} px from the edge, but "
        f"{CLEAR:g} are required: the model-free MTF50 may be wrong by {share:.0%}; choose a wider region"
    )
    return [Trace(share, Remark("narrow-region", text), "free")]


def _veiled(region: _EdgeRegion) -> list[Trace]:
    """Estimate the error of MTF50 that uneven light causes if this light resembles glare."""
    edge, light = region.edge, region.light
    glare, seen = edge.glare_fraction, f"glare of {edge.glare_fraction:.1%} over {edge.glare_radius:.0f} px may be"
    if light is not None and light.amplitude > 0:
        text = f"uneven light of {light.amplitude:.1%} beyond the terms up to third order was removed"
        if glare > 0:
            text += f"; {seen} the remainder of this light: the MTF excludes the glare"
        if light.ghost.share > _GHOST:
            text += f"; a ghost with {light.ghost.share:.1%} of the step, {light.ghost.position:.0f} px from the edge, "
            text += "explains part of this light: the MTF includes the effect of the ghost"
        return [Trace(0.0, Remark("uneven-light", text), "glare")]
    width = (2 if region.mosaic else 1) * (region.value.shape[1] - 1)
    possible = 1.0 if edge.glare_radius > VEIL * width else 0.0 if light is None else light.possible
    unsure = max(min(glare, possible), 0.0)
    # Glare decreases MTF50 by 0.72 of its share.
    share = 0.72 * unsure
    # An error below 0.5 % is not reported.
    text = f"{seen}{'' if unsure == glare else ' in part'} uneven light: MTF50 with glare may be too low by {share:.0%}"
    return [Trace(share, Remark("wide-glare", text) if share > 0.005 else None, "glare")]


def _ghost(region: _EdgeRegion) -> list[Trace]:
    ghost, light = region.ghost, region.light
    if ghost.share < max(_GHOST, 4.0 * ghost.std):
        if light is None or light.amplitude or light.ghost.rms < _GHOST:
            return []
        text = f"a ghost with {light.ghost.rms:.1%} of the step may lie {light.ghost.position:.0f} px from the edge"
        return [Trace(0.0, Remark("ghost", f"{text}: the standard deviation of the MTF includes its effect"))]
    side = "bright" if ghost.bright else "dark"
    text = f"a ghost with {ghost.share:.1%} of the step lies {ghost.position:.1f} px from the edge, on the {side} side"
    return [Trace(0.0, Remark("ghost", f"{text}: the MTF includes the effect of the ghost"))]


def _smoothed(region: _EdgeRegion) -> list[Trace]:
    """Detect correlated noise, and estimate the error of MTF50 due to smoothing.

    The error is smaller for a wider blur.
    """
    noise = region.noise
    if not noise.smoothed:
        return []
    seen = noise.correlation
    if noise.compressed and not noise.denoised:
        text = f"{seen}, and JPEG block borders occur every 8 px: the image may have been denoised or sharpened"
        # Block borders up to a strength of 3 have no effect. Stronger ones change MTF50 by 0.6 % per strength.
        share = float(np.clip(0.006 * (noise.grid - 3.0), 0.0, 0.05))
        more = f"; MTF50 may be wrong by {share:.1%}" if share else ""
        return [Trace(share, Remark("compressed", f"{text}{more}: use camera raw"))]
    if not noise.denoised:
        text = (
            f"{seen}: the image was demosaiced, resampled or smoothed; its MTF is not that of the lens: use camera raw"
        )
        return [Trace(0.0, Remark("demosaiced", text))]
    share = smoothing_uncertainty(region.blur, denoised=True)
    text = (
        f"{seen} over several px: the image was denoised, and its MTF is not that of the lens; "
        f"MTF50 may be wrong by {share:.0%}: use camera raw"
    )
    return [Trace(share, Remark("denoised", text))]


def _tone_curve(region: _EdgeRegion) -> list[Trace]:
    if not region.noise.tone_curve_suspected:
        return []
    edge = region.edge
    step = edge.bright - edge.dark
    # The assumed exponent of the tone curve approximates that of sRGB (IEC 61966-2-1).
    effect = _effect_of_tone(edge, lambda seen: np.maximum(edge.dark + step * seen, 0) ** 2.2)
    share = max(TONE_CURVE_UNCERTAINTY, effect)
    text = f"{region.noise.tone}, and MTF50 may be wrong by {share:.0%}: specify the tone curve (--tone)"
    return [Trace(share, Remark("tone-curve", text))]


def _sharpened(region: _EdgeRegion) -> list[Trace]:
    noise = region.noise
    over, std = region.edge.overshoot, max(region.edge.overshoot_std, 1e-4)
    apart = 0.0 if noise.smoothed else noise.apart
    sure = over > max(SHARPENED, SIGNIFICANT * std)
    # JPEG compression causes ringing next to an edge, which resembles an overshoot.
    # A weaker sign of sharpening is an overshoot above 0.3 %, if overshoot and noise together have a significance of
    # 3.5.
    if not sure and (noise.compressed or over < 0.003 or (over / std + apart) / np.sqrt(2) < 3.5):
        return []
    # An unsharp mask increases MTF50 by 12 times its overshoot.
    share = 12.0 * over
    text = f"the edge overshoots by {over:.1%}"
    if sure:
        text += ": the image is sharpened, and the MTF includes the sharpening"
    else:
        text += f", as in a sharpened image: MTF50 may be too high by {share:.0%}"
    return [Trace(share, Remark("sharpened", text))]


def _slightly_sharpened(region: _EdgeRegion) -> list[Trace]:
    """Detect a weak unsharp mask that explains edge and noise together, although the overshoot is not significant."""
    seen = region.correlations
    # For most images, the noise excludes the mask, and the slower fits of the edge are skipped.
    if seen is None or region.noise.smoothed or (gain := mask_gain(seen)) < 0:
        return []
    gain += edge_gain(region.edge.bare)
    if gain < needed_gain(region.edge.bare.blur):
        return []
    share = effect_on_half(region.edge.frequency, region.edge.mtf)
    text = (
        "the noise of neighbouring pixels is anticorrelated and the edge overshoots as after an unsharp mask of "
        f"{AMOUNT:.0%} (2 ln likelihood higher by {gain:.0f}): the image may be sharpened; MTF50 may be too high by {share:.1%}"
    )
    return [Trace(share, Remark("sharpened", text))]


def _filtered(region: _EdgeRegion, smoothed: list[Trace], raised: list[Trace]) -> list[Trace]:
    """Estimate the error of MTF50 that a linear filter causes, from the correlation of the noise.

    `smoothed`, `raised`: traces of smoothing and of sharpening, whose variance is subtracted.
    """
    uncertainty = filter_uncertainty(
        region.correlations, region.edge.frequency, region.edge.mtf, sharpened=bool(raised)
    )
    more = float(np.sqrt(max(uncertainty.share**2 - sum(trace.share**2 for trace in (*smoothed, *raised)), 0.0)))
    if smoothed or raised or uncertainty.probability < 0.5:
        return [Trace(more)]
    kind, off = ("smooths", "low") if uncertainty.smooths else ("sharpens or deconvolves", "high")
    text = f"the noise of neighbours is correlated as after a filter that {kind} (probability {uncertainty.probability:.1%})"
    return [
        Trace(more, Remark("filtered", f"{text}: MTF50 may be too {off} by {uncertainty.share:.0%}; use camera raw"))
    ]


def _crushed(region: _EdgeRegion) -> list[Trace]:
    piled = crushed_share(*(count for _, count in region.levels))
    if not piled:
        return []
    # The smallest error due to crushed blacks is 1 %.
    share = max(0.01, _effect_of_crushing(region))
    text = (
        f"blacks are crushed: {piled:.0%} of the dark side has the lowest value; MTF50 may be too high by {share:.0%}"
    )
    return [Trace(share, Remark("crushed", text))]


def _coarse(region: _EdgeRegion) -> list[Trace]:
    """Estimate the error of MTF50 that rounding to coarse levels causes.

    If levels have the distance a and the noise has the standard deviation s, the error of the mean of rounded values is
    at most (a / pi) exp(-2 pi^2 s^2 / a^2) (Widrow & Kollar, Quantization Noise, 2008, ch. 9).
    """
    value, of_sides = region.value, [levels for levels, _ in region.levels]
    levels = np.unique(value[np.isfinite(value)])
    # Codes with more than 2000 different values are not coarse.
    if not all(own.size for own in of_sides) or not 2 <= levels.size <= 2000:
        return []
    gaps, errors = np.diff(levels), []
    for (own, count), variance in zip(region.levels, region.noise.variance, strict=True):
        middle = own[np.searchsorted(np.cumsum(count), (count.sum() + 1) // 2)]
        # Four levels on both sides are compared, because an image without noise lacks some levels.
        at = int(np.searchsorted(levels, middle))
        apart = float(gaps[max(at - 4, 0) : at + 4].min())
        # Rounding adds variance. Noise that extends to a third level can be separated from it.
        beyond = float(np.clip(np.sort(count)[:-2].sum(), 0.5, None) / count.sum())
        noisy = min(max(variance - apart**2 / 12, 0.0), (apart / ndtri(beyond / 2)) ** 2)
        errors.append(apart * np.exp(-2 * np.pi**2 * noisy / apart**2))
    step = region.edge.bright - region.edge.dark
    # The factor is the rms over 12 to 512 levels without noise.
    share = 0.2 * float(np.hypot(*errors)) / step
    text = f"codes are coarse: the step has only {step / max(gaps.min(), 1e-300):.0f} levels, and the noise is below one level"
    remark = Remark("quantised", f"{text}; MTF50 may be wrong by {share:.1%}: use a file with a larger bit depth")
    return [Trace(share, remark if share > _LEAST_REPORTED else None)]


def _asymmetric(region: _EdgeRegion) -> list[Trace]:
    """Estimate the error of MTF50 if a tone curve causes the asymmetry of the edge response.

    Let v be the light between the dark level (0) and the bright level (1). A tone curve v + q v (1 - v) adds q E (1 -
    E) to an edge response E, but a symmetric lens does not. The variance of photon noise is proportional to the light.
    A variance of the dark side that is larger than expected from its light makes a tone curve more probable.
    """
    edge, bare, noise = region.edge, region.edge.bare, region.noise
    if region.ghost.share > 0:
        return []
    at = bare.distance / np.sqrt(bare.blur**2 + bare.spread)
    response, line = ndtr(at), np.exp(-(at**2) / 2)
    # The other free terms describe levels and light, position and width of the edge, and the deviation of the lens from a
    # Gaussian.
    shape = np.stack([response * (1 - response), response, line, at * line, at**3 * line])
    columns = np.concatenate([shape, bare.light])
    if edge.glare_fraction > 0:
        columns = np.concatenate([columns, ndtr(bare.distance / edge.glare_radius)[None]])
    weight = 1 / np.hypot(bare.std, LEAST_NOISE)
    scale = np.linalg.norm(columns * weight, axis=1)
    inverse = np.linalg.pinv((columns * weight / np.maximum(scale, 1e-300)[:, None]).T, rcond=1e-6)
    curvature = float(inverse[0] @ (bare.value * weight)) / scale[0]
    variance = float(inverse[0] @ inverse[0]) / scale[0] ** 2
    # The curvature of tone curves has a prior standard deviation of 0.3.
    prior = 0.3**2
    gain = curvature**2 / variance * prior / (prior + variance) / 2
    odds = np.exp(min(gain, 50.0)) / np.sqrt(1 + prior / variance)
    # Dark noise in excess, by 15 % of the variance of photon noise, increases the prior probability from 2 % to 50 %.
    raised = ndtr((noise.tilt - 1.15 * edge.dark / edge.bright) / noise.tilt_std)
    first = 0.02 + 0.48 * float(np.nan_to_num(raised))
    probability = first * odds / (1 + first * (odds - 1))
    # A tone curve with a probability below 1 % has no noticeable effect. One is reported above 99 %.
    if probability < 0.01:
        return []
    lowest = float(np.clip(edge.dark / edge.bright, 0.0, 0.9))
    share = float(np.sqrt(probability)) * _effect_of_tone(edge, lambda seen: _shoulder_undone(seen, lowest, curvature))
    text = "the edge response is not symmetric, because of coma of the lens or a nonlinear tone curve (a highlight shoulder)"
    remark = Remark(
        "asymmetric", f"{text}; MTF50 may be wrong by {share:.1%}: specify the tone curve if there is one (--tone)"
    )
    return [Trace(share, remark if probability >= 0.99 and share >= _LEAST_REPORTED else None)]


def _shoulder_undone(response: FloatArray, lowest: float, curvature: float) -> FloatArray:
    """Invert a tone curve with a shoulder, tanh(b v), where v is the light.

    The parameter b follows from `curvature`. `curvature`: q of `_asymmetric`; if q is negative, the shoulder is on the
    dark side. `lowest`: light of the dark side relative to the light of the bright side.
    """
    if curvature < 0:
        return 1 - _shoulder_undone(1 - response, 0.0, -curvature)
    shoulders = np.linspace(0.05, 3.0, 60)
    ends, middle = np.tanh(shoulders * lowest), np.tanh(shoulders * (1 + lowest) / 2)
    curvatures = 4 * ((middle - ends) / (np.tanh(shoulders) - ends) - 0.5)
    b = float(np.interp(curvature, curvatures, shoulders))
    return np.arctanh(np.tanh(b * lowest) + (np.tanh(b) - np.tanh(b * lowest)) * response) / b


def _effect_of_tone(edge: EdgeMTF, undone: Callable[[FloatArray], FloatArray]) -> float:
    """Compute the absolute relative change of MTF50 by a tone curve.

    `undone`: function that converts an edge response (0 to 1) after the tone curve to light.
    """
    # The samples are 0.1 px apart, and the frequencies 2.4e-3 cycles/px.
    distance, count = np.linspace(-40.0, 40.0, 801), 4096
    response = np.clip(edge_response(edge.fits.free, distance).value, 0, 1)

    def half(light: FloatArray) -> float:
        transfer = np.abs(np.fft.rfft(np.diff(light), count)) / (light[-1] - light[0])
        return float(first_fall(np.fft.rfftfreq(count, distance[1] - distance[0]), transfer))

    effect = half(response) / half(undone(response)) - 1
    return abs(effect) if np.isfinite(effect) else 0.0


def _effect_of_crushing(region: _EdgeRegion) -> float:
    """Compute the absolute relative change of the width of a fitted Gaussian edge by crushed blacks."""
    cells, blur = region.edge.samples, region.blur
    used = np.abs(cells.distance) < 6 * blur + 2
    d, value, weight = cells.distance[used], cells.value[used], 1 / np.maximum(cells.std[used], 1e-3)

    def cut(p: np.ndarray) -> np.ndarray:
        return (np.maximum(ndtr((d - p[0]) / p[1]) - p[2], 0) / (1 - p[2]) - value) * weight

    plain = least_squares(lambda p: cut(np.append(p, 0.0)), [0.0, blur], bounds=([-5, 0.05], [5, 50]))
    starts = ([0.0, max(blur, 0.06), share] for share in (0.02, 0.1, 0.3))
    fits = [least_squares(cut, start, bounds=([-5, 0.05, 0.0], [5, 50, 0.8])) for start in starts]
    best = min(fits, key=lambda fit: fit.cost)
    return float(abs(1 - plain.x[1] / best.x[1]))
