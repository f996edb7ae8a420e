"""What software has done to a picture of an edge, as far as its pixels show it, and how wrong that may make an MTF.

Nobody can measure a lens behind a denoiser. But its traces can be found: in the noise of the flat sides (`flat_noise.py`), in
levels that many pixels share, in an overshoot. Each trace is named, with what it may do to the MTF, and adds to the stated
errors: as an unknown scale of frequency, relative, which leaves an MTF of 1 at frequency 0 alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.special import ndtr, ndtri

from matcam.calibration.edge.edge_result import SHARPENED, EdgeMTF, EdgeStack
from matcam.calibration.edge.free_curve import ghost_of
from matcam.calibration.edge.maximum_likelihood import ADDED, SHIFT
from matcam.calibration.edge.measurement import EdgeFits
from matcam.calibration.edge.rows import CLEAR, EdgeRegions, clearance
from matcam.calibration.edge.wider_errors import widened, with_core_as_total, with_ghosts, with_jumps
from matcam.calibration.photograph.flat_noise import BENT_DOUBT, FlatNoise, crushed_share, flat_noise, smoothing_doubt
from matcam.calibration.photograph.linear_filters import Correlations, correlations, filter_doubt, mask_gain
from matcam.calibration.photograph.slight_sharpening import (
    AMOUNT,
    BareEdge,
    edge_gain,
    effect_on_half,
    needed_gain,
)
from matcam.calibration.photograph.uneven_light import LightField
from matcam.core.arrays import FloatArray, tuple_map
from matcam.core.remark import Remark
from matcam.numerics.crossing import first_fall

_REACH, _MORE = 3.0, 2.0  # of the blur, px: beyond both a side is flat
_BOX = 0.29  # px: standard deviation of a pixel
_GAMMA = 2.2
_SIDE, _SAMPLES = 40.0, 801
"""Distance to both sides of an edge at which its response is sampled, px; number of samples, 0.1 px apart."""
_TRANSFORM = 4096
"""Samples of the transform of a line spread function, whose frequencies are then 2.4e-3 cycles/px apart."""
_TONE_BEND, _TONE_PROBABILITIES, _RAISED = 0.3, (0.02, 0.5), 1.15
"""Standard deviation of a tone curve's bend; its probabilities where the noise of the dark is that of photons, and where it is
higher; and from which multiple on it is higher.
"""
_SURE_TONE, _NO_TONE = 0.99, 0.01
"""Probabilities of a tone curve from which it is remarked on, and below which its effect is not computed."""
_PER_OVERSHOOT = 12.0  # of MTF50, by the overshoot that an unsharp mask leaves
_OVERSHOOT, _SURE = 0.003, 3.5  # of the step; standard deviations of both signs of sharpening together
_CRUSHED = 0.01  # of MTF50, at least
_MOST_LEVELS = 2000
"""Different values above which a picture is not a picture of coarse codes."""
_PER_LEVEL = 0.2
"""Relative error of MTF50 by the distance of two levels in units of the step: rms of 12 to 512 levels without noise."""
_NEAR_LEVELS = 4
"""Levels to both sides of a flat side among which the least distance is that of all: a picture without noise misses some."""
_SMALL_DOUBT = 1e-3
"""Relative error of MTF50 below which it is not remarked on."""
_TAILS, _FADING = 0.08, 0.6  # of MTF50, where the blur reaches the border; blurs over which that fades
_SURER = 0.1  # of that, of a lens model
_SURE_GLARE = 0.005
"""Relative error of MTF50 below which a doubt on glare is not remarked on."""
_PER_STEP = 1.5
"""Relative error of MTF50 by a step of the light across the edge, in units of the step: penumbrae of tests/oracle."""
_BY_GLARE = 0.72  # of MTF50 by the share of glare, where the MTF is one half
_PER_BORDER, _HARMLESS, _MOST_BY_BLOCKS = 0.006, 3.0, 0.05  # of MTF50 by how much JPEG's borders stand out
_LEAST_NOISE = 2e-4  # of the step
_GHOST, _SURE_GHOST = 0.01, 4.0  # of the step; standard deviations, from which a ghost is remarked on


class Traces(NamedTuple):
    """Hold what software has left in one picture.

    Attributes:
        remarks: what was seen, and what it may do.
        share: standard deviation of MTF50 by it, relative.
        free: the same, of the free estimate alone.
        glare: the same, of what contains glare.
    """

    remarks: tuple[Remark, ...]
    share: float
    free: float = 0.0
    glare: float = 0.0


def with_traces(stack: EdgeStack, regions: Iterable[EdgeRegions], lights: Sequence[LightField | None]) -> EdgeStack:
    """Add to results what light and software may have done to their pictures: remarks, and wider errors.

    Where glare and light cannot be told apart, the MTF is that of the lens without glare.

    stack: results of n edges. regions: their rows, in even light. lights: uneven light of each, None where there is none.
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
    """Return what is found in the region of edge i, the k-th of its regions.

    clear: how far it stands off the borders, in standard deviations of its blur. light: uneven light that was found in it.
    """
    value, fits = rows.value[k], stack.fits
    place = np.polyval(np.asarray(fits.curve[i])[::-1], rows.y[k])
    across = rows.start[k][:, None] + rows.step * np.arange(value.shape[1]) - place[:, None]
    distance = across / np.hypot(1.0, float(fits.slope[i]))
    blur = float(np.hypot(fits.free.shape.sigma[i], _BOX))
    reach = _REACH * blur + _MORE
    there = np.isfinite(value)
    dark, bright = there & (distance < -reach), there & (distance > reach)
    step = float(stack.bright[i] - stack.dark[i])
    noise = flat_noise(value, dark, bright, lines=rows.step == 1, least=_LEAST_NOISE * abs(step))
    found = _smoothed(noise, blur)
    raised = list[tuple[Remark | None, float]]()
    # a mosaic is filtered after it has been filled in, and rounding has no correlation
    known = rows.step == 1 and np.isfinite(noise.alike_std)
    seen = correlations(np.where(there, value, 0.0), (dark, bright)) if known else None
    if clear > CLEAR:
        raised = _sharpened(stack, i, noise) or _slightly_sharpened(stack, i, noise, seen)
    if not noise.compressed:
        raised += _filtered(stack, i, seen, (found, raised))
    found += raised
    found += _crushed(stack, i, crushed_share(value[dark], value[bright]))
    coarse = _coarse(value, (dark, bright), noise, step)
    found += coarse + (
        _bent(stack, i, noise) or ([] if any(remark for remark, _ in coarse) else _asymmetric(stack, i, noise))
    )
    by_light = 0.0 if light is None else _PER_STEP * light.unknown
    share = float(np.hypot.reduce([by_light, *(share for _, share in found)]))
    narrow, free = _narrow(clear, blur)
    veiled, glare = _veiled(stack, i, light)
    remarks = (*(remark for remark, _ in found), narrow, veiled, _ghost(stack, i))
    return Traces(tuple(remark for remark in remarks if remark), float(np.hypot(share, free * _SURER)), free, glare)


def _narrow(clear: float, blur: float) -> tuple[Remark | None, float]:
    """Return what a blur that reaches the region's border leaves unsure of the free estimate."""
    share = _TAILS * float(np.clip((CLEAR - clear) / _FADING, 0.0, 1.0))
    if not share:
        return None, 0.0
    text = (
        f"the blur ({blur:.1f} px) reaches the region's border, {clear:.1f} of it away, so that the levels are unsure"
    )
    return Remark(
        "narrow-region", f"{text}: MTF50 free of a model may be wrong by {share:.0%}; take a wider region"
    ), share


def _veiled(stack: EdgeStack, i: int, light: LightField | None) -> tuple[Remark | None, float]:
    """Estimate the error of MTF50 because uneven light looks like glare."""
    glare, radius = float(stack.glare_fraction[i]), float(stack.glare_radius[i])
    if light is not None and light.amplitude > 0:
        text = f"uneven light of {light.amplitude:.1%}, beyond light of third order, was taken out"
        if glare > 0:
            text += f"; glare of {glare:.1%} over {radius:.0f} px may be its remainder: the MTF is that without glare"
        return Remark("uneven-light", text), 0.0
    unsure = max(min(glare, 0.0 if light is None else light.possible), 0.0)
    share = _BY_GLARE * unsure
    part = "" if unsure == glare else " in part"
    text = f"glare of {glare:.1%} over {radius:.0f} px may be uneven light{part}"
    text += f": MTF50 with it may be too low by {share:.0%}"
    return Remark("wide-glare", text) if share > _SURE_GLARE else None, share


def _ghost(stack: EdgeStack, i: int) -> Remark | None:
    """Return that there is a second, weaker edge, which is part of what was measured."""
    ghost = ghost_of(tuple_map(lambda a: a[i], stack.fits.free))
    if ghost.share < max(_GHOST, _SURE_GHOST * ghost.std):
        return None
    side = "bright" if ghost.bright else "dark"
    text = f"a second edge of {ghost.share:.1%} of the step lies {ghost.place:.1f} px away, on the {side} side"
    return Remark("ghost", f"{text}: a ghost; it is part of the MTF")


def _smoothed(noise: FlatNoise, blur: float) -> list[tuple[Remark | None, float]]:
    """Return what noise says that neighbours share.

    blur: px. The wider it is, the less a smoothing of so many px changes it.
    """
    if not noise.smoothed:
        return []
    seen = f"neighbours err alike (by {noise.alike:.2f} of independent noise)"
    if noise.compressed and not noise.denoised:
        text = (
            f"{seen} and there are borders every 8 px: JPEG; whether it was denoised or sharpened before does not show"
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
    """Return what noise says that is larger in the dark."""
    if not noise.bent:
        return []
    dark, bright = float(stack.dark[i]), float(stack.bright[i])
    effect = _effect_of_tone(stack[i], lambda response: np.maximum(dark + (bright - dark) * response, 0) ** _GAMMA)
    share = max(BENT_DOUBT, effect)
    text = f"dark pixels err {noise.tilt:.1f} times as much as bright ones: a tone curve that was not undone (--tone)"
    return [(Remark("tone-curve", f"{text}? MTF50 may be wrong by {share:.0%}"), share)]


def _sharpened(stack: EdgeStack, i: int, noise: FlatNoise) -> list[tuple[Remark | None, float]]:
    """Return what overshoot and noise say together."""
    over, std = float(stack.overshoot[i]), max(float(stack.overshoot_std[i]), 1e-4)
    apart = 0.0 if noise.smoothed else noise.apart
    # beside an edge JPEG rings
    if over < (SHARPENED if noise.compressed else _OVERSHOOT) or (over / std + apart) / np.sqrt(2) < _SURE:
        return []
    share = _PER_OVERSHOOT * over
    text = f"the edge overshoots by {over:.1%}, as in a sharpened picture: MTF50 may be too high by {share:.0%}"
    return [(Remark("sharpened", text) if over <= SHARPENED else None, share)]


def _slightly_sharpened(
    stack: EdgeStack, i: int, noise: FlatNoise, seen: Correlations | None
) -> list[tuple[Remark | None, float]]:
    """Return what an unsharp mask explains of edge and noise together, where no overshoot shows it.

    seen: correlations of the noise; None where nothing is known.
    """
    # noise that speaks against the mask spares most pictures the fits
    if seen is None or noise.smoothed or (gain := mask_gain(seen)) < 0:
        return []
    edge = _bare(tuple_map(lambda a: np.asarray(a)[i], stack.fits))
    gain += edge_gain(edge)
    if gain < needed_gain(edge.blur):
        return []
    share = effect_on_half(stack.frequency, stack.mtf[i])
    text = (
        f"neighbours err apart and the edge overshoots as behind an unsharp mask of {AMOUNT:.0%} (2 ln likelihood "
        f"{gain:.0f} more): a sharpened picture? MTF50 may be too high by {share:.1%}"
    )
    return [(Remark("sharpened", text), share)]


def _filtered(
    stack: EdgeStack,
    i: int,
    seen: Correlations | None,
    others: tuple[list[tuple[Remark | None, float]], list[tuple[Remark | None, float]]],
) -> list[tuple[Remark | None, float]]:
    """Estimate the error of MTF50 by a linear filter, from the correlation of the noise; other traces of filters count once.

    seen: as in `_slightly_sharpened`. others: remarks and errors that were found for smoothing, and for sharpening.
    """
    smoothed, raised = others
    doubt = filter_doubt(seen, stack.frequency, stack.mtf[i], sharpened=bool(raised))
    more = np.sqrt(max(doubt.share**2 - sum(share**2 for _, share in (*smoothed, *raised)), 0.0))
    if smoothed or raised or doubt.probability < 0.5:
        return [(None, float(more))]
    kind, off = ("smooths", "low") if doubt.smooths else ("sharpens or deconvolves", "high")
    text = f"the noise of neighbours is correlated as behind a filter that {kind} (probability {doubt.probability:.1%})"
    return [(Remark("filtered", f"{text}: MTF50 may be too {off} by {doubt.share:.0%}"), float(more))]


def _bare(fits: EdgeFits) -> BareEdge:
    """Return an edge's cells, free of a lens."""
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
    """Return what a dark side of one value says."""
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
        # rounding has a variance of its own, and noise that reaches a third level can be told from it
        count = np.sort(np.unique(value[side], return_counts=True)[1])
        beyond = float(np.clip(count[:-2].sum(), 0.5, None) / count.sum())
        noisy = min(max(variance - apart**2 / 12, 0.0), (apart / ndtri(beyond / 2)) ** 2)
        errors.append(apart * np.exp(-2 * np.pi**2 * noisy / apart**2))
    share = _PER_LEVEL * float(np.hypot(*errors)) / step
    steps = step / max(gaps.min(), 1e-300)
    text = f"levels are coarse: {steps:.0f} of them from dark to bright, and less noise than one"
    text += f"; MTF50 may be wrong by {share:.1%}"
    return [(Remark("quantised", text) if share > _SMALL_DOUBT else None, share)]


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
    # levels and light, the edge's place and its width, and a lens that is not Gaussian, are free besides
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
    lowest = float(np.clip(stack.dark[i] / stack.bright[i], 0.0, 0.9))
    effect = _effect_of_tone(stack[i], lambda response: _shoulder_undone(response, lowest, bend))
    share = float(np.sqrt(probability)) * effect
    if probability < _SURE_TONE or share < _SMALL_DOUBT:
        return [(None, share)]
    text = (
        "the edge response is not symmetric: coma of the lens, or a tone curve that bends, such as a highlight shoulder"
    )
    return [(Remark("asymmetric", f"{text}; MTF50 may be wrong by {share:.1%}"), share)]


def _shoulder_undone(response: FloatArray, lowest: float, bend: float) -> FloatArray:
    """Undo a shoulder tanh(b v) that bends an edge response by `bend`, q of `_asymmetric`.

    lowest: light of the dark side over that of the bright one. A negative bend is a shoulder in the dark.
    """
    if bend < 0:
        return 1 - _shoulder_undone(1 - response, 0.0, -bend)
    shoulders = np.linspace(0.05, 3.0, 60)
    ends, middle = np.tanh(shoulders * lowest), np.tanh(shoulders * (1 + lowest) / 2)
    bends = 4 * ((middle - ends) / (np.tanh(shoulders) - ends) - 0.5)
    b = float(np.interp(bend, bends, shoulders))
    return np.asarray(np.arctanh(np.tanh(b * lowest) + (np.tanh(b) - np.tanh(b * lowest)) * response) / b)


def _effect_of_tone(edge: EdgeMTF, undone: Callable[[FloatArray], FloatArray]) -> float:
    """Compute by how much a tone curve has changed MTF50, relative, without sign.

    undone: edge response, from 0 to 1, behind the curve -> light.
    """
    distance = np.linspace(-_SIDE, _SIDE, _SAMPLES)
    response = np.clip(edge.esf(distance).value, 0, 1)

    def half(light: FloatArray) -> float:
        transfer = np.abs(np.fft.rfft(np.diff(light), _TRANSFORM)) / (light[-1] - light[0])
        return float(first_fall(np.fft.rfftfreq(_TRANSFORM, distance[1] - distance[0]), transfer))

    effect = half(response) / half(undone(response)) - 1
    return abs(effect) if np.isfinite(effect) else 0.0


def _effect_of_crushing(stack: EdgeStack, i: int) -> float:
    """Return by how much crushed blacks narrow the edge, relative: a Gaussian's own foot, cut or not, is fitted."""
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
