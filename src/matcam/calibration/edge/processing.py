"""Traces of processing in a picture of an edge, and their effect on an MTF.

A lens cannot be measured behind a denoiser, but the traces of the denoiser can be found: in the noise of the flat sides
(`flat_noise.py`), in levels that many pixels share, in an overshoot. Each trace is named with its possible effect on
the MTF, and adds to the stated errors: as an unknown relative scale of frequency, which only leaves an MTF of 1 at
frequency 0 unchanged.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.special import ndtr, ndtri

from matcam.calibration.edge.edge_result import SHARPENED, EdgeStack
from matcam.calibration.edge.free_curve import ghost_of
from matcam.calibration.edge.free_fit import VEIL
from matcam.calibration.edge.maximum_likelihood import ADDED, SHIFT
from matcam.calibration.edge.measurement import EdgeFits
from matcam.calibration.edge.rows import CLEAR, EdgeRegions, clearance
from matcam.calibration.edge.wider_errors import widened, with_core_as_total, with_ghosts, with_jumps
from matcam.calibration.photograph.flat_noise import BENT_DOUBT, FlatNoise, crushed_share, flat_noise, smoothing_doubt
from matcam.calibration.photograph.linear_filters import filter_doubt, half_of
from matcam.calibration.photograph.slight_sharpening import (
    AMOUNT,
    APART,
    BareEdge,
    edge_gain,
    effect_on_half,
    needed_gain,
    noise_gain,
    noise_score,
)
from matcam.calibration.photograph.uneven_light import LightField
from matcam.core.arrays import FloatArray, tuple_map
from matcam.core.remark import Remark

_REACH, _MORE = 3.0, 2.0  # multiple of the blur, and px: beyond both a side is flat
_BOX = 0.29  # px: standard deviation of a pixel
_GAMMA = 2.2
_TRANSFORM = 8192
"""Samples of the transform of a line spread function, whose frequencies are then 2.4e-3 cycles/px apart."""
_TONE_BEND, _TONE_PROBABILITIES, _RAISED = 0.3, (0.02, 0.5), 1.15
"""Standard deviation of the curvature of a tone curve; its probabilities if the noise of the dark side is photon noise,
and if it is higher; and the ratio above which it is higher.
"""
_SURE_TONE, _NO_TONE = 0.99, 0.01
"""Probabilities of a tone curve above which it is reported, and below which its effect is not computed."""
_PER_OVERSHOOT = 12.0  # of MTF50, per overshoot of an unsharp mask
_OVERSHOOT, _SURE = 0.003, 3.5  # relative to the step; standard deviations of both signs of sharpening together
_CRUSHED = 0.01  # of MTF50, smallest value
_MOST_LEVELS = 2000
"""Number of different values above which a picture does not have coarse codes."""
_PER_LEVEL = 0.2
"""Relative error of MTF50 per distance of two levels in units of the step: rms of 12 to 512 levels without noise."""
_NEAR_LEVELS = 4
"""Number of levels on both sides of that of a flat side whose smallest distance is used: a picture without noise lacks
some levels.
"""
_SMALL_DOUBT = 1e-3
"""Relative error of MTF50 below which it is not reported."""
_TAILS, _FADING = 0.08, 0.6  # of MTF50, if the blur extends to the border; widths of the blur over which it falls to 0
_SURER = 0.1  # share of it for a lens model
_SURE_GLARE = 0.005
"""Relative error of MTF50 below which an uncertain glare is not reported."""
_PER_STEP = 1.5
"""Relative error of MTF50 by a step of the light across the edge, in units of the step: penumbrae of tests/oracle."""
_BY_GLARE = 0.72  # of MTF50 per share of glare, at an MTF of one half
_PER_BORDER, _HARMLESS, _MOST_BY_BLOCKS = 0.006, 3.0, 0.05  # of MTF50 per strength of the JPEG block borders
_LEAST_NOISE = 2e-4  # relative to the step
_GHOST, _SURE_GHOST = 0.01, 4.0  # relative to the step, and standard deviations, above which a ghost is reported


class Traces(NamedTuple):
    """Traces of processing in one picture.

    Attributes:
        remarks: the traces, and their possible effects.
        share: relative standard deviation of MTF50 from the traces.
        free: the same, of the free estimate alone.
        glare: the same, for curves with glare.
    """

    remarks: tuple[Remark, ...]
    share: float
    free: float = 0.0
    glare: float = 0.0


def with_traces(stack: EdgeStack, regions: Iterable[EdgeRegions], lights: Sequence[LightField | None]) -> EdgeStack:
    """Add the effects of light and processing to the results of a stack: remarks, and larger errors.

    If glare and light cannot be distinguished, the MTF is that of the lens without glare. `stack`: results of n edges.
    `regions`: their rows, in even light. `lights`: uneven light of each, or None.
    """
    shares, given = np.zeros((3, len(stack))), list(stack.given or [()] * len(stack))
    first = 0
    for rows in regions:
        part = slice(first, first + len(rows.value))
        clear = clearance(tuple_map(lambda a: a[part], stack.fits), rows)  # noqa: B023
        for k in range(len(rows.value)):
            i = first + k
            if stack.problems[i] is None:
                traces = _traces(stack, i, rows, k, float(clear[k]), lights[i])
                shares[:, i] = traces.share, traces.free, traces.glare
                given[i] = given[i] + traces.remarks
        first += len(rows.value)
    stack = with_core_as_total(stack, np.array([light is not None and light.amplitude > 0 for light in lights]))
    ghosts = np.array([0.0 if light is None else light.ghost for light in lights])
    return with_jumps(with_ghosts(widened(replace(stack, given=tuple(given)), shares), ghosts))


def _traces(stack: EdgeStack, i: int, rows: EdgeRegions, k: int, clear: float, light: LightField | None) -> Traces:
    """Find the traces in the region of edge i, the k-th of its regions.

    `clear`: its distance from the borders, in standard deviations of its blur. `light`: uneven light that was found in
    it.
    """
    value, fits = rows.value[k], stack.fits
    y, start = (np.broadcast_to(a, (len(rows.value), value.shape[0]))[k] for a in (rows.y, rows.start))
    place = np.polyval(np.asarray(fits.curve[i])[::-1], y)
    across = start[:, None] + rows.step * np.arange(value.shape[1]) - place[:, None]
    distance = across / np.hypot(1.0, float(fits.slope[i]))
    blur = float(np.hypot(fits.free.shape.sigma[i], _BOX))
    reach = _REACH * blur + _MORE
    there = np.isfinite(value)
    dark, bright = there & (distance < -reach), there & (distance > reach)
    step = float(stack.bright[i] - stack.dark[i])
    noise = flat_noise(value, dark, bright, lines=rows.step == 1, least=_LEAST_NOISE * abs(step))
    found = _smoothed(noise, blur)
    one, raised = value if rows.step == 1 else None, list[tuple[Remark | None, float]]()
    if clear > CLEAR:
        raised = _sharpened(stack, i, noise) or _slightly_sharpened(stack, i, noise, one, (dark, bright))
    if one is not None and not noise.compressed and np.isfinite(noise.alike_std):
        raised += _filtered(stack, i, np.where(there, one, 0.0), (dark, bright), (found, raised))
    found += raised
    found += _crushed(stack, i, crushed_share(value[dark], value[bright]))
    coarse = _coarse(value, (dark, bright), noise, step)
    found += coarse + (
        _bent(stack, i, noise) or ([] if any(remark for remark, _ in coarse) else _asymmetric(stack, i, noise))
    )
    by_light = 0.0 if light is None else _PER_STEP * light.unknown
    share = float(np.hypot.reduce([by_light, *(share for _, share in found)]))
    narrow, free = _narrow(clear, blur)
    veiled, glare = _veiled(stack, i, rows.step * (value.shape[1] - 1), light)
    remarks = (*(remark for remark, _ in found), narrow, veiled, _ghost(stack, i))
    return Traces(tuple(remark for remark in remarks if remark), float(np.hypot(share, free * _SURER)), free, glare)


def _narrow(clear: float, blur: float) -> tuple[Remark | None, float]:
    """Estimate the error of the free estimate if the blur extends to the border of the region."""
    share = _TAILS * float(np.clip((CLEAR - clear) / _FADING, 0.0, 1.0))
    if not share:
        return None, 0.0
    text = f"the blur ({blur:.1f} px) extends to the region's border, {clear:.1f} of it away, so that the levels are uncertain"
    return Remark(
        "narrow-region", f"{text}: MTF50 free of a model may be wrong by {share:.0%}; take a wider region"
    ), share


def _veiled(stack: EdgeStack, i: int, width: float, light: LightField | None) -> tuple[Remark | None, float]:
    """Estimate the error of MTF50 because uneven light looks like glare.

    width: px, of the region.
    """
    glare, radius = float(stack.glare_fraction[i]), float(stack.glare_radius[i])
    if light is not None and light.amplitude > 0:
        text = f"uneven light of {light.amplitude:.1%}, beyond levels and a plane, was taken out"
        if glare > 0:
            text += f"; glare of {glare:.1%} over {radius:.0f} px may be its remainder: the MTF is that without glare"
        return Remark("uneven-light", text), 0.0
    if not glare > 0:
        return None, 0.0
    unsure = glare if radius > VEIL * width else min(glare, 0.0 if light is None else light.possible)
    share = _BY_GLARE * unsure
    part = "" if unsure == glare else " in part"
    text = f"glare of {glare:.1%} over {radius:.0f} px may be uneven light{part}"
    text += f": MTF50 with it may be too low by {share:.0%}"
    return Remark("wide-glare", text) if share > _SURE_GLARE else None, share


def _ghost(stack: EdgeStack, i: int) -> Remark | None:
    """Describe a second, weaker edge, whose effect is part of the measured MTF."""
    ghost = ghost_of(tuple_map(lambda a: a[i], stack.fits.free))
    if ghost.share < max(_GHOST, _SURE_GHOST * ghost.std):
        return None
    side = "bright" if ghost.bright else "dark"
    text = f"a second edge of {ghost.share:.1%} of the step lies {ghost.place:.1f} px away, on the {side} side"
    return Remark("ghost", f"{text}: a ghost; it is part of the MTF")


def _smoothed(noise: FlatNoise, blur: float) -> list[tuple[Remark | None, float]]:
    """Estimate the error of MTF50 from smoothing, by the correlation of the noise.

    `blur`: px. The wider it is, the less it is changed by smoothing over a given number of px.
    """
    if not noise.smoothed:
        return []
    seen = f"the noise of neighbouring pixels is correlated ({noise.alike:.2f} of independent noise)"
    if noise.compressed and not noise.denoised:
        text = (
            f"{seen} and there are borders every 8 px: JPEG; it is unknown whether it was denoised or sharpened before"
        )
        share = float(np.clip(_PER_BORDER * (noise.grid - _HARMLESS), 0.0, _MOST_BY_BLOCKS))
        more = f"; MTF50 may be wrong by {share:.1%}" if share else ""
        return [(Remark("compressed", text + more), share)]
    if not noise.denoised:
        text = f"{seen}: a demosaiced picture, or one that was resampled or smoothed, whose MTF is not the lens's"
        return [(Remark("demosaiced", text), 0.0)]
    share = smoothing_doubt(blur, denoised=True)
    text = (
        f"{seen}, over several px: a denoised picture, whose MTF is not the lens's; MTF50 may be wrong by {share:.0%}"
    )
    return [(Remark("denoised", text), share)]


def _bent(stack: EdgeStack, i: int, noise: FlatNoise) -> list[tuple[Remark | None, float]]:
    """Describe noise that is larger in dark areas."""
    if not noise.bent:
        return []
    share = max(BENT_DOUBT, abs(_effect_of_gamma(stack, i)))
    text = f"the noise of dark pixels is {noise.tilt:.1f} times that of bright ones: a tone curve that was not undone (--tone)"
    return [(Remark("tone-curve", f"{text}? MTF50 may be wrong by {share:.0%}"), share)]


def _sharpened(stack: EdgeStack, i: int, noise: FlatNoise) -> list[tuple[Remark | None, float]]:
    """Estimate the error of MTF50 from sharpening, by overshoot and noise."""
    over, std = float(stack.overshoot[i]), max(float(stack.overshoot_std[i]), 1e-4)
    apart = 0.0 if noise.smoothed else noise.apart
    # JPEG causes ringing next to an edge
    if over < (SHARPENED if noise.compressed else _OVERSHOOT) or (over / std + apart) / np.sqrt(2) < _SURE:
        return []
    share = _PER_OVERSHOOT * over
    text = f"the edge overshoots by {over:.1%}, as in a sharpened picture: MTF50 may be too high by {share:.0%}"
    return [(Remark("sharpened", text) if over <= SHARPENED else None, share)]


def _slightly_sharpened(
    stack: EdgeStack, i: int, noise: FlatNoise, value: FloatArray | None, sides: tuple[np.ndarray, np.ndarray]
) -> list[tuple[Remark | None, float]]:
    """Estimate the error of MTF50 from an unsharp mask without visible overshoot.

    `value`: the region; None for a mosaic, which is sharpened after interpolation. `sides`: its flat areas.
    """
    if value is None or noise.smoothed:
        return []
    apart = noise_score(value, sides)
    if apart < APART:  # misses 1 in 50 of slightly sharpened pictures, and avoids the fits for half of all others
        return []
    gain = noise_gain(apart, int(sides[0].sum() + sides[1].sum()))
    edge = _bare(tuple_map(lambda a: np.asarray(a)[i], stack.fits))
    gain += edge_gain(edge)
    if gain < needed_gain(edge.blur):
        return []
    share = effect_on_half(stack.frequency, stack.mtf[i])
    text = (
        "the noise of neighbouring pixels is anticorrelated and the edge overshoots as behind an unsharp mask of "
        f"{AMOUNT:.0%} (2 ln likelihood {gain:.0f} more): a sharpened picture? MTF50 may be too high by {share:.1%}"
    )
    return [(Remark("sharpened", text), share)]


def _filtered(
    stack: EdgeStack,
    i: int,
    value: FloatArray,
    sides: tuple[np.ndarray, np.ndarray],
    others: tuple[list[tuple[Remark | None, float]], list[tuple[Remark | None, float]]],
) -> list[tuple[Remark | None, float]]:
    """Estimate the error of MTF50 by a linear filter, from the correlation of the noise; the other traces of filters
    are not counted twice.

    value: of the region. sides: its flat parts. others: remarks and errors that were found for smoothing, and for sharpening.
    """
    smoothed, raised = others
    doubt = filter_doubt(value, sides, stack.frequency, stack.mtf[i], sharpened=bool(raised))
    more = np.sqrt(max(doubt.share**2 - sum(share**2 for _, share in (*smoothed, *raised)), 0.0))
    if smoothed or raised or doubt.probability < 0.5:
        return [(None, float(more))]
    kind, off = ("smooths", "low") if doubt.smooths else ("sharpens or deconvolves", "high")
    text = f"the noise of neighbours is correlated as behind a filter that {kind} (probability {doubt.probability:.1%})"
    return [(Remark("filtered", f"{text}: MTF50 may be too {off} by {doubt.share:.0%}"), float(more))]


def _bare(fits: EdgeFits) -> BareEdge:
    """Return the cells of an edge without lens effects."""
    cells, used = fits.cells, fits.cells.pixels > 0
    terms, levels, free = cells.terms[:, used], fits.free.levels, fits.state.used
    # `light_of` and `Noise.variance` would be compiled for every number of cells
    factor, addend = 1 + levels[2 : SHIFT - ADDED] @ terms, levels[SHIFT - ADDED :] @ terms[:ADDED]
    expected, dim = fits.parametric.expected[used], cells.dim[used]
    variance = fits.noise.gain * np.maximum(expected, 0.0) * dim + (fits.noise.read * dim) ** 2
    value = cells.value[used] - addend
    bent = value / factor * terms[free[2 : SHIFT - ADDED] > 0]
    return BareEdge(
        distance=np.asarray(cells.distance[used] + fits.state.linear[SHIFT]),
        spread=np.asarray(cells.spread[used]),
        value=np.asarray(value),
        std=np.asarray(np.sqrt(fits.excess * variance / cells.pixels[used])),
        step=np.asarray((levels[1] - levels[0]) * factor),
        light=np.concatenate([factor[None], bent, terms[:ADDED][free[SHIFT - ADDED : SHIFT] > 0]]),
        blur=float(np.hypot(fits.free.shape.sigma, fits.free.shape.half_width / np.sqrt(3))),
    )


def _crushed(stack: EdgeStack, i: int, piled: float) -> list[tuple[Remark, float]]:
    """Estimate the error of MTF50 if the dark side has one value."""
    if not piled:
        return []
    share = max(_CRUSHED, _effect_of_crushing(stack, i))
    text = f"blacks are crushed: {piled:.0%} of the dark side has the very lowest value; MTF50 may be too high by {share:.0%}"
    return [(Remark("crushed", text), share)]


def _coarse(
    value: FloatArray, sides: tuple[np.ndarray, np.ndarray], noise: FlatNoise, step: float
) -> list[tuple[Remark | None, float]]:
    """Estimate the error of MTF50 by rounding to coarse levels.

    The mean of rounded values errs by at most (level / pi) exp(-2 pi^2 noise^2 / level^2) (Widrow & Kollar, Quantization
    Noise, 2008, ch. 9).

    value: region (height, width), linear. sides: its flat parts, dark and bright, bool. step: bright less dark.
    """
    levels = np.unique(value[np.isfinite(value)])
    if not 2 <= levels.size <= _MOST_LEVELS or not all(side.any() for side in sides):
        return []
    gaps, errors = np.diff(levels), []
    for side, variance in zip(sides, noise.variance, strict=True):
        at = int(np.searchsorted(levels, np.median(value[side])))
        apart = float(gaps[max(at - _NEAR_LEVELS, 0) : at + _NEAR_LEVELS].min())
        # rounding adds its own variance, and noise that extends to a third level can be separated from it
        count = np.sort(np.unique(value[side], return_counts=True)[1])
        beyond = float(np.clip(count[:-2].sum(), 0.5, None) / count.sum())
        noisy = min(max(variance - apart**2 / 12, 0.0), (apart / ndtri(beyond / 2)) ** 2)
        errors.append(apart * np.exp(-2 * np.pi**2 * noisy / apart**2))
    share = _PER_LEVEL * float(np.hypot(*errors)) / step
    steps = step / max(gaps.min(), 1e-300)
    text = f"levels are coarse: {steps:.0f} of them from dark to bright, and less noise than one"
    text += f"; MTF50 may be wrong by {share:.1%}"
    return [(Remark("quantised", text) if share > _SMALL_DOUBT else None, share)]


def _effect_of_gamma(stack: EdgeStack, i: int) -> float:
    """Compute the relative change of MTF50 if a gamma is undone."""
    distance = np.linspace(-40, 40, 1601)
    response = np.asarray(stack[i].esf(distance).value)
    levels = float(stack.dark[i]) + float(stack.bright[i] - stack.dark[i]) * np.clip(response, 0, 1)
    plain, undone = (_half(distance, v) for v in (levels, np.maximum(levels, 0) ** _GAMMA))
    return float(undone / plain - 1) if np.isfinite(undone / plain) else 0.0


def _asymmetric(stack: EdgeStack, i: int, noise: FlatNoise) -> list[tuple[Remark | None, float]]:
    """Estimate the error of MTF50 because an asymmetric edge response may come from a tone curve, not from the lens.

    A tone curve v + q v (1 - v) between the levels adds q E (1 - E) to a response E; a symmetric lens does not. The variance of
    photon noise is proportional to the light. More variance than that on the dark side makes a tone curve more probable.
    """
    fits = tuple_map(lambda a: np.asarray(a)[i], stack.fits)
    if ghost_of(fits.free).share > 0:
        return []
    edge = _bare(fits)
    width = np.sqrt(edge.blur**2 + edge.spread)
    at = edge.distance / width
    response, line = ndtr(at), np.exp(-(at**2) / 2)
    # also free are levels and light, the position and width of the edge, and a lens that is not Gaussian
    even = np.stack([response, line, at * line, at**3 * line]) * edge.step
    columns = np.concatenate([(edge.step * response * (1 - response))[None], even, edge.light])
    if stack.glare_fraction[i] > 0:
        columns = np.concatenate([columns, (ndtr(edge.distance / stack.glare_radius[i]) * edge.step)[None]])
    weight = 1 / np.hypot(edge.std, _LEAST_NOISE * edge.step)
    scale = np.linalg.norm(columns * weight, axis=1)
    inverse = np.linalg.pinv((columns * weight / np.maximum(scale, 1e-300)[:, None]).T, rcond=1e-6)
    bend = float(inverse[0] @ (edge.value * weight)) / scale[0]
    variance = float(inverse[0] @ inverse[0]) / scale[0] ** 2
    prior = _TONE_BEND**2
    gain = bend**2 / variance * prior / (prior + variance) / 2
    odds = np.exp(min(gain, 50.0)) / np.sqrt(1 + prior / variance)
    raised = ndtr((noise.tilt - _RAISED * stack.dark[i] / stack.bright[i]) / noise.tilt_std)
    first = float(np.interp(raised, (0.0, 1.0), _TONE_PROBABILITIES)) if np.isfinite(raised) else _TONE_PROBABILITIES[0]
    probability = first * odds / (1 + first * (odds - 1))
    if probability < _NO_TONE:
        return []
    effect = abs(_effect_of_shoulder(stack, i, bend))
    share = float(np.sqrt(probability)) * effect
    if probability < _SURE_TONE or share < _SMALL_DOUBT:
        return [(None, share)]
    text = (
        "the edge response is not symmetric: coma of the lens, or a tone curve that bends, such as a highlight shoulder"
    )
    return [(Remark("asymmetric", f"{text}; MTF50 may be wrong by {share:.1%}"), share)]


def _effect_of_shoulder(stack: EdgeStack, i: int, bend: float) -> float:
    """Compute the relative change of MTF50 by a shoulder tanh(b v) of a given curvature.

    `bend`: q of `_asymmetric`; negative: a shoulder in the dark.
    """
    distance = np.linspace(-40, 40, 1601)
    response = np.clip(np.asarray(stack[i].esf(distance).value), 0, 1)
    lowest = float(np.clip(stack.dark[i] / stack.bright[i], 0.0, 0.9))
    if bend < 0:
        response, lowest = 1 - response[::-1], 0.0
    shoulders = np.linspace(0.05, 3.0, 60)
    ends, middle = np.tanh(shoulders * lowest), np.tanh(shoulders * (1 + lowest) / 2)
    bends = 4 * ((middle - ends) / (np.tanh(shoulders) - ends) - 0.5)
    b = float(np.interp(abs(bend), bends, shoulders))
    light = np.arctanh(np.tanh(b * lowest) + (np.tanh(b) - np.tanh(b * lowest)) * response) / b
    seen, undone = (_half(distance, levels) for levels in (response, light))
    return float(seen / undone - 1) if np.isfinite(seen / undone) else 0.0


def _half(distance: FloatArray, levels: FloatArray) -> float:
    """Find the frequency at which the transfer of an edge response falls to one half, or NaN.

    `distance`: px, evenly spaced.
    """
    transfer = np.abs(np.fft.rfft(np.diff(levels), _TRANSFORM)) / (levels[-1] - levels[0])
    return half_of(np.arange(transfer.size) / (_TRANSFORM * (distance[1] - distance[0])), transfer)


def _effect_of_crushing(stack: EdgeStack, i: int) -> float:
    """Compute the relative narrowing of the edge by crushed blacks, from a Gaussian with and without its clipped foot."""
    cells = stack[i].samples
    blur = float(np.hypot(stack.fits.free.shape.sigma[i], _BOX))
    used = np.abs(cells.distance) < 6 * blur + 2
    d, value, weight = cells.distance[used], cells.value[used], 1 / np.maximum(cells.std[used], 1e-3)

    def whole(p: np.ndarray) -> np.ndarray:
        return np.asarray((ndtr((d - p[0]) / p[1]) - value) * weight)

    def cut(p: np.ndarray) -> np.ndarray:
        return np.asarray((np.maximum(ndtr((d - p[0]) / p[1]) - p[2], 0) / (1 - p[2]) - value) * weight)

    plain = least_squares(whole, [0.0, blur], bounds=([-5, 0.05], [5, 50]))
    starts = ([0.0, max(blur, 0.06), share] for share in (0.02, 0.1, 0.3))
    fits = [least_squares(cut, start, bounds=([-5, 0.05, 0.0], [5, 50, 0.8])) for start in starts]
    best = min(fits, key=lambda fit: fit.cost)
    return float(abs(1 - plain.x[1] / best.x[1]))
