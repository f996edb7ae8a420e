"""From rows of samples to both estimates: the one program that runs on every edge, alone or by the thousand."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from matcam.calibration.edge import free_fit, geometry
from matcam.calibration.edge import free_fit as curves
from matcam.calibration.edge import free_fit as glare
from matcam.calibration.edge import geometry as cells_
from matcam.calibration.edge.free_basis import Shape, scale
from matcam.calibration.edge.free_fit import FREQUENCIES, Sampled
from matcam.calibration.edge.geometry import Aligned, Cells, Rows
from matcam.calibration.edge.maximum_likelihood import (
    LINEAR,
    CurveStep,
    Model,
    Noise,
    State,
    curve_step,
    model,
    scoring_step,
)
from matcam.calibration.edge.profiles import Gaussian, LensModel
from matcam.core.jax import AnyArray, jax, jnp
from matcam.numerics.linalg import scaled_inverse

_START = -0.5  # ln px: sigma 0.6
_STEPS, _MODEL_STEPS = 3, 12
_LEVEL_REACH = 6.0  # px from the edge: only levels and noise beyond
_LEAST_NOISE = 1e-4  # of the step: rounding, and what no model describes
_EXPECTED = 1.4  # chi2 per degree of freedom of some 200 cells: 4 sigma


class Parametric(NamedTuple):
    """The maximum likelihood fit of a family of lenses."""

    state: State
    covariance: jax.Array
    """(5 + k,) squared."""
    chi2: jax.Array
    degrees: jax.Array
    """Cells less parameters."""
    structure: free_fit.Structure
    numbers: jax.Array
    """(k,) the lens's, in the units of their names."""
    numbers_covariance: jax.Array
    expected: jax.Array
    """(n,) values of the cells."""
    mtf: Sampled
    mtf50: Sampled


class Measurement(NamedTuple):
    """Everything that was found of one edge, in px from the region's centre and the picture's units."""

    curve: jax.Array
    curve_covariance: jax.Array
    angle: jax.Array
    crossing: jax.Array
    """Rows that the edge crosses, away from the borders."""
    noise: Noise
    residual: jax.Array
    """Standard deviation of single pixels about the fit, near the edge."""
    parametric: Parametric
    free: free_fit.FreeCurve
    mtf: Sampled
    mtf50: Sampled
    core_mtf: Sampled
    core_mtf50: Sampled
    overshoot: Sampled
    """Largest excess of the ESF over its levels, where it is most significant."""
    cells: Cells
    state: State
    """Of the Gaussian fit, about which everything stands."""
    excess: jax.Array
    """Factor by which variances were raised, because cells scatter more than the estimated noise."""


class _Fits(NamedTuple):
    """What has been found of an edge before glare is considered."""

    crossing: jax.Array
    known: jax.Array
    noise: Noise
    curve: jax.Array
    moved: CurveStep
    cells: Cells
    state: State
    model: Model
    free: free_fit.LinearFit
    structure: free_fit.Structure
    glare: glare.Look


class _Turn(NamedTuple):
    curve: jax.Array
    cells: Cells
    state: State
    model: Model
    moved: CurveStep


@partial(jax.jit, static_argnames=("step", "turns"))
def measure(
    value: AnyArray,
    y: AnyArray,
    start: AnyArray,
    noise: Noise,
    half_width: AnyArray | np.float64,
    *,
    step: int,
    turns: int,
) -> Measurement:
    """Both estimates for the edge in one `Rows`, the parametric one Gaussian. Noise that is NaN is estimated from the
    picture. turns: of profile and curve, each fitted while the other is held."""
    fits = _fits(Rows(value, y, start, step), noise, jnp.asarray(half_width), turns)
    found = fits.glare.gain > glare.FOUND
    curve = jax.lax.cond(found, glare.with_glare, lambda fit, _: free_fit.without_glare(fit), fits.free, fits.glare)
    return _report(fits, curve, jnp.asarray(half_width))


@partial(jax.jit, static_argnames=("step", "turns"))
def measure_stack(
    values: AnyArray,
    y: AnyArray,
    start: AnyArray,
    noise: Noise,
    half_width: AnyArray | np.float64,
    *,
    step: int,
    turns: int,
) -> Measurement:
    """`measure` for a stack of regions, side by side: values (n, rows, columns), y and start (n, rows)."""
    half_width = jnp.asarray(half_width)

    def fitted(value: jax.Array, y: jax.Array, start: jax.Array) -> _Fits:
        return _fits(Rows(value, y, start, step), noise, half_width, turns)

    fits = jax.vmap(fitted)(*map(jnp.asarray, (values, y, start)))
    found = fits.glare.gain > glare.FOUND

    def some(fits: _Fits) -> free_fit.FreeCurve:
        plain, glaring = jax.vmap(free_fit.without_glare)(fits.free), jax.vmap(glare.with_glare)(fits.free, fits.glare)
        return jax.tree.map(lambda a, b: jnp.where(found.reshape(-1, *[1] * (a.ndim - 1)), a, b), glaring, plain)

    # under vmap both sides of a condition are computed: ask once for all of them
    curve = jax.lax.cond(jnp.any(found), some, lambda fits: jax.vmap(free_fit.without_glare)(fits.free), fits)
    return jax.vmap(lambda fits, curve: _report(fits, curve, half_width))(fits, curve)


@jax.jit
def fit_lens(found: Measurement, half_width: AnyArray | np.float64, lens: LensModel) -> Parametric:
    """The parametric estimate by another family of lenses, for an edge that has been measured."""
    half_width = jnp.asarray(half_width)
    profile = lens.profile(found.angle, half_width)
    start = State(found.state.linear, lens.start(found.state.profile[0]))
    fitted = _climb(found.cells, start, profile, found.noise, lens, _MODEL_STEPS)
    tested = model(found.cells, fitted, profile)
    at = model(found.cells, found.state, Gaussian().profile(found.angle, half_width))
    _, structure = free_fit.solve(found.cells, found.state, at, found.noise, found.free.shape, tested)
    return _parametric(found.cells, fitted, tested, found.noise, structure, lens, found.angle, half_width, found.excess)


def _fits(rows: Rows, noise: Noise, half_width: jax.Array, rounds: int) -> _Fits:
    start, crossing = geometry.first_curve(rows)
    aligned = geometry.align(rows, start)
    dark, bright = geometry.sides(aligned, rows.step)
    known = ~(jnp.isnan(noise.gain) | jnp.isnan(noise.read))
    noise = _or_estimated(noise, aligned, geometry.distance(start, aligned.x, aligned.y[:, None]), rows.step)
    family = Gaussian()

    def turn(at: tuple[jax.Array, State], _: None) -> tuple[tuple[jax.Array, State], _Turn]:
        """Profile and levels on the cells, then the curve on the pixels."""
        curve, state = at
        distance = geometry.distance(curve, aligned.x, aligned.y[:, None])
        phase = cells_.phases(aligned, curve, rows.step)
        cells = cells_.gather(aligned, distance, phase, rows.step)
        profile = family.profile(jnp.arctan(curve[1]), half_width)
        state = _climb(cells, state, profile, noise, family, _STEPS)
        now = model(cells, state, profile)
        moved = curve_step(aligned, distance, phase, cells, now, state, noise, curve, rows.step)
        centred = state._replace(linear=state.linear.at[4].set(0.0))
        return (moved.curve, centred), _Turn(curve, cells, state, now, moved)

    first = State(jnp.stack([dark.mean(), bright.mean(), *jnp.zeros(3)]), jnp.array([_START]))
    _, turns = jax.lax.scan(turn, (start, first), None, length=rounds)
    curve, cells, state, at, moved = jax.tree.map(lambda a: a[-1], turns)
    shape = Shape(jnp.exp(state.profile[0]), jnp.arctan(curve[1]), half_width, jnp.ones(()))
    free, structure = free_fit.solve(cells, state, at, noise, shape, at)
    return _Fits(crossing, known, noise, curve, moved, cells, state, at, free, structure, glare.look(free))


def _report(fits: _Fits, free: free_fit.FreeCurve, half_width: jax.Array) -> Measurement:
    # noise that was estimated from neighbours may not be all: then the cells' scatter about the free curve speaks
    taken = jnp.where(fits.glare.gain > glare.FOUND, fits.glare.gain, 0.0)
    scatter = (fits.free.chi2 - taken) / fits.free.degrees
    excess = jnp.where(fits.known | (scatter < _EXPECTED), 1.0, scatter)
    free = free._replace(covariance=free.covariance * excess)
    angle = jnp.arctan(fits.curve[1])
    mtf, core = curves.transfer(free, jnp.asarray(FREQUENCIES))
    return Measurement(
        curve=fits.curve,
        curve_covariance=fits.moved.covariance * excess,
        angle=angle,
        crossing=fits.crossing,
        noise=fits.noise,
        residual=fits.moved.residual,
        parametric=_parametric(
            fits.cells, fits.state, fits.model, fits.noise, fits.structure, Gaussian(), angle, half_width, excess
        ),
        free=free,
        mtf=mtf,
        mtf50=curves.half(mtf.value, lambda f: curves.transfer(free, f)[0]),
        core_mtf=core,
        core_mtf50=curves.half(core.value, lambda f: curves.transfer(free, f)[1]),
        overshoot=_overshoot(free),
        cells=fits.cells,
        state=fits.state,
        excess=excess,
    )


def _climb(cells: Cells, state: State, profile, noise: Noise, lens: LensModel, steps: int) -> State:  # type: ignore[no-untyped-def]
    longest = jnp.array(lens.longest)
    step = partial(scoring_step, cells, profile=profile, noise=noise, longest=longest)
    return jax.lax.fori_loop(0, steps, lambda _, s: step(s), state)


def _or_estimated(known: Noise, aligned: Aligned, distance: jax.Array, step: int) -> Noise:
    """What is not known of the noise, from the differences of neighbours (but one) on both sides of the edge."""
    difference = aligned.value[:, 2:] - aligned.value[:, :-2]
    both = aligned.valid[:, 2:] * aligned.valid[:, :-2]
    away = distance[:, 1:-1]
    far = both * (jnp.abs(away) > jnp.minimum(_LEVEL_REACH, 0.3 * step * aligned.value.shape[1]))

    def side(part: jax.Array) -> tuple[jax.Array, jax.Array]:
        weight = far * part
        count = jnp.maximum(weight.sum(), 1.0)
        return (weight * aligned.value[:, 1:-1]).sum() / count, (weight * difference**2).sum() / (2 * count)

    (low, v_low), (high, v_high) = side(away < 0), side(away > 0)
    gain = jnp.clip((v_high - v_low) / (high - low), 0.0, v_high / jnp.maximum(high, 1e-300))
    read2 = jnp.maximum((v_low + v_high) / 2 - gain * (low + high) / 2, 0.0) + (_LEAST_NOISE * (high - low)) ** 2
    return Noise(
        jnp.where(jnp.isnan(known.gain), gain, known.gain),
        jnp.where(jnp.isnan(known.read), jnp.sqrt(read2), known.read),
    )


def _overshoot(free: free_fit.FreeCurve) -> Sampled:
    reach = jnp.linspace(1.0, 6.0, 11) * scale(free.shape)
    response = curves.edge_response(free, jnp.concatenate([-reach[::-1], reach]))
    excess = jnp.concatenate([-response.value[: reach.size], response.value[reach.size :] - 1])
    most = jnp.argmax(excess)
    return Sampled(excess[most], response.std[most])


def _parametric(
    cells: Cells, state: State, at: Model, noise: Noise, structure: free_fit.Structure, lens: LensModel,
    angle: jax.Array, half_width: jax.Array, excess: jax.Array,
) -> Parametric:  # fmt: skip
    weight = cells.pixels / noise.variance(at.value)
    covariance = excess * scaled_inverse((at.design * weight) @ at.design.T)
    lens_covariance = covariance[LINEAR:, LINEAR:]

    def response(f: jax.Array) -> Sampled:
        value, slopes = _with_slopes(lambda p: lens.mtf(p, f, angle, half_width), state.profile)
        return Sampled(value, jnp.sqrt(jnp.maximum((slopes @ lens_covariance * slopes).sum(-1), 0.0)))

    numbers, by = _with_slopes(lens.numbers, state.profile)
    mtf = response(jnp.asarray(FREQUENCIES))
    return Parametric(
        state=state,
        covariance=covariance,
        chi2=(weight * (cells.value - at.value) ** 2).sum(),
        degrees=(cells.pixels > 0).sum() - state.profile.size - LINEAR,
        structure=structure,
        numbers=numbers,
        numbers_covariance=by @ lens_covariance @ by.T,
        expected=at.value,
        mtf=mtf,
        mtf50=curves.half(mtf.value, response),
    )


def _with_slopes(function, at: jax.Array):  # type: ignore[no-untyped-def]
    return function(at), jax.jacfwd(function)(at)
