"""From rows of samples to both estimates: the one program that runs on every edge, alone or by the thousand."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from matcam.calibration.edge import free_curve, free_fit, geometry
from matcam.calibration.edge.free_curve import FREQUENCIES, CoreShape, FreeCurve, SampledCurve
from matcam.calibration.edge.geometry import AlignedRows, EdgeCells, Rows
from matcam.calibration.edge.maximum_likelihood import (
    LINEAR,
    CurveStep,
    EdgeModel,
    Noise,
    State,
    curve_step,
    edge_model,
    scoring_step,
)
from matcam.calibration.edge.profiles import Gaussian, LensAtEdge, LensModel
from matcam.core.jax import AnyArray, jax, jnp
from matcam.numerics.linalg import scaled_inverse

_START = -0.5  # ln px: sigma 0.6
_STEPS, _MODEL_STEPS = 3, 12
_LEVEL_REACH = 6.0  # px from the edge: only levels and noise beyond
_LEAST_NOISE = 1e-4  # of the step: rounding, and what no model describes
_EXPECTED = 1.4  # chi2 per degree of freedom of some 200 cells: 4 sigma


class LensFit(NamedTuple):
    """Hold the maximum likelihood fit of a family of lenses.

    Attributes:
        state: the parameters.
        covariance: (5 + k,) squared.
        chi2: of the cells, under the noise.
        degrees: cells less parameters.
        structure: what the free curve finds in the residuals.
        numbers: (k,) the lens's parameters, in the units of their names.
        numbers_covariance: (k, k).
        expected: (n,) values of the cells.
        mtf: at `FREQUENCIES`.
        mtf50: cycles/px.
    """

    state: State
    covariance: jax.Array
    chi2: jax.Array
    degrees: jax.Array
    structure: free_fit.Structure
    numbers: jax.Array
    numbers_covariance: jax.Array
    expected: jax.Array
    mtf: SampledCurve
    mtf50: SampledCurve


class EdgeFits(NamedTuple):
    """Hold both estimates of one edge.

    Lengths are px from the region's centre, values the picture's units.

    Attributes:
        curve: (3,) where the edge runs.
        curve_covariance: (3, 3).
        angle: rad, of the normal to the grid.
        crossing: how many rows the edge crosses, away from the borders.
        noise: given, or estimated.
        residual: standard deviation of single pixels about the fit, near the edge.
        parametric: fit of a family of lenses.
        free: the curve without a model.
        mtf: at `FREQUENCIES`.
        mtf50: cycles/px.
        core_mtf: the MTF without glare.
        core_mtf50: cycles/px.
        overshoot: largest excess of the ESF over its levels.
        cells: means of the pixels.
        state: of the Gaussian fit, about which everything stands.
        excess: factor by which variances were raised, because cells scatter more than the estimated noise.
    """

    curve: jax.Array
    curve_covariance: jax.Array
    angle: jax.Array
    crossing: jax.Array
    noise: Noise
    residual: jax.Array
    parametric: LensFit
    free: FreeCurve
    mtf: SampledCurve
    mtf50: SampledCurve
    core_mtf: SampledCurve
    core_mtf50: SampledCurve
    overshoot: SampledCurve
    cells: EdgeCells
    state: State
    excess: jax.Array


class _Stage(NamedTuple):
    """Hold what has been found of an edge before glare is considered."""

    crossing: jax.Array
    known: jax.Array
    noise: Noise
    curve: jax.Array
    moved: CurveStep
    cells: EdgeCells
    model: EdgeModel
    free: free_fit.LinearFit
    structure: free_fit.Structure
    glare: free_fit.GlareCandidate


class _Turn(NamedTuple):
    """Hold one turn of the fits of profile and curve."""

    curve: jax.Array
    cells: EdgeCells
    model: EdgeModel
    moved: CurveStep


@partial(jax.jit, static_argnames=("step", "turns"))
def edge_fits(
    value: AnyArray,
    y: AnyArray,
    start: AnyArray,
    noise: Noise,
    half_width: AnyArray | np.float64,
    *,
    step: int,
    turns: int,
) -> EdgeFits:
    """Return both estimates for the edge in one region.

    value, y, start, step: as in `geometry.Rows`. The parametric estimate is Gaussian. noise: NaN where it is to be
    estimated. turns: of profile and curve, each fitted while the other stays.
    """
    stage = _stage(Rows(value, y, start, step), noise, jnp.asarray(half_width), turns)
    found = stage.glare.rise > free_fit.FOUND
    plain = lambda fit, _: free_fit.curve_without_glare(fit)  # noqa: E731
    curve = jax.lax.cond(found, free_fit.curve_with_glare, plain, stage.free, stage.glare)
    return _edge_fits(stage, curve, jnp.asarray(half_width))


@partial(jax.jit, static_argnames=("step", "turns"))
def edge_fits_of_stack(
    values: AnyArray,
    y: AnyArray,
    start: AnyArray,
    noise: Noise,
    half_width: AnyArray | np.float64,
    *,
    step: int,
    turns: int,
) -> EdgeFits:
    """Return `edge_fits` of many regions, side by side.

    value: (n, rows, columns). y and start: (n, rows).
    """
    half_width = jnp.asarray(half_width)

    def of_one(value: jax.Array, y: jax.Array, start: jax.Array) -> _Stage:
        return _stage(Rows(value, y, start, step), noise, half_width, turns)

    stages = jax.vmap(of_one)(*map(jnp.asarray, (values, y, start)))
    found = stages.glare.rise > free_fit.FOUND

    def without(stages: _Stage) -> FreeCurve:
        return jax.vmap(free_fit.curve_without_glare)(stages.free)

    def some(stages: _Stage) -> FreeCurve:
        plain, glaring = without(stages), jax.vmap(free_fit.curve_with_glare)(stages.free, stages.glare)
        return jax.tree.map(lambda a, b: jnp.where(found.reshape(-1, *[1] * (a.ndim - 1)), a, b), glaring, plain)

    # under vmap both sides of a condition are computed: ask once for all of them
    curves = jax.lax.cond(jnp.any(found), some, without, stages)
    return jax.vmap(lambda stage, curve: _edge_fits(stage, curve, half_width))(stages, curves)


@jax.jit
def lens_fit(found: EdgeFits, half_width: AnyArray | np.float64, lens: LensModel) -> LensFit:
    """Return the parametric estimate by another family of lenses."""
    seen = LensAtEdge(lens, found.angle, jnp.asarray(half_width))
    start = State(found.state.linear, lens.start(found.state.profile[0]))
    fitted = _climb(found.cells, start, seen, found.noise, _MODEL_STEPS)
    tested = edge_model(found.cells, fitted, seen.profile)
    at = edge_model(found.cells, found.state, seen._replace(lens=Gaussian()).profile)
    _, structure = free_fit.linear_fit(found.cells, at, found.noise, found.free.shape, tested)
    return _lens_fit(found.cells, tested, found.noise, structure, seen, found.excess)


def _stage(rows: Rows, noise: Noise, half_width: jax.Array, rounds: int) -> _Stage:
    """Fit curve, Gaussian lens and free curve."""
    start, crossing = geometry.first_curve(rows)
    aligned = geometry.aligned_rows(rows, start)
    dark, bright = geometry.side_levels(aligned)
    known = ~(jnp.isnan(noise.gain) | jnp.isnan(noise.read))
    noise = _or_estimated(noise, aligned, geometry.edge_distance(start, aligned.x, aligned.y[:, None]))

    def turn(at: tuple[jax.Array, State], _: None) -> tuple[tuple[jax.Array, State], _Turn]:
        """Fit profile and levels to cells, then the curve to pixels."""
        curve, state = at
        phased = geometry.phased_rows(aligned, curve)
        cells = geometry.edge_cells(phased)
        seen = LensAtEdge(Gaussian(), jnp.arctan(curve[1]), half_width)
        state = _climb(cells, state, seen, noise, _STEPS)
        now = edge_model(cells, state, seen.profile)
        moved = curve_step(phased, cells, now, noise)
        centred = state._replace(linear=state.linear.at[4].set(0.0))
        return (moved.curve, centred), _Turn(curve, cells, now, moved)

    first = State(jnp.stack([dark.mean(), bright.mean(), *jnp.zeros(3)]), jnp.array([_START]))
    _, turns = jax.lax.scan(turn, (start, first), None, length=rounds)
    curve, cells, at, moved = jax.tree.map(lambda a: a[-1], turns)
    shape = CoreShape(jnp.exp(at.state.profile[0]), jnp.arctan(curve[1]), half_width, jnp.ones(()))
    free, structure = free_fit.linear_fit(cells, at, noise, shape, at)
    return _Stage(crossing, known, noise, curve, moved, cells, at, free, structure, free_fit.glare_candidate(free))


def _edge_fits(stage: _Stage, free: FreeCurve, half_width: jax.Array) -> EdgeFits:
    """Read everything off the fits."""
    # noise that was estimated from neighbours may not be all: then the cells' scatter about the free curve speaks
    by_glare = jnp.where(stage.glare.rise > free_fit.FOUND, stage.glare.rise, 0.0)
    scatter = (stage.free.chi2 - by_glare) / stage.free.degrees
    excess = jnp.where(stage.known | (scatter < _EXPECTED), 1.0, scatter)
    free = free._replace(covariance=free.covariance * excess)
    seen = LensAtEdge(Gaussian(), jnp.arctan(stage.curve[1]), half_width)
    mtf, core = free_curve.transfer(free, jnp.asarray(FREQUENCIES))
    return EdgeFits(
        curve=stage.curve,
        curve_covariance=stage.moved.covariance * excess,
        angle=seen.angle,
        crossing=stage.crossing,
        noise=stage.noise,
        residual=stage.moved.residual,
        parametric=_lens_fit(stage.cells, stage.model, stage.noise, stage.structure, seen, excess),
        free=free,
        mtf=mtf,
        mtf50=free_curve.half_frequency(mtf.value, lambda f: free_curve.transfer(free, f)[0]),
        core_mtf=core,
        core_mtf50=free_curve.half_frequency(core.value, lambda f: free_curve.transfer(free, f)[1]),
        overshoot=_overshoot(free),
        cells=stage.cells,
        state=stage.model.state,
        excess=excess,
    )


def _climb(cells: EdgeCells, state: State, seen: LensAtEdge, noise: Noise, steps: int) -> State:
    """Return the parameters after some steps of Fisher scoring."""
    longest = jnp.array(seen.lens.longest)
    step = partial(scoring_step, cells, profile=seen.profile, noise=noise, longest=longest)
    return jax.lax.fori_loop(0, steps, lambda _, s: step(s), state)


def _or_estimated(known: Noise, aligned: AlignedRows, distance: jax.Array) -> Noise:
    """Return the noise; estimate what is not known of it.

    The differences of neighbours but one, on both sides of the edge, tell it.
    """
    difference = aligned.value[:, 2:] - aligned.value[:, :-2]
    both = aligned.valid[:, 2:] * aligned.valid[:, :-2]
    away = distance[:, 1:-1]
    far = both * (jnp.abs(away) > jnp.minimum(_LEVEL_REACH, 0.3 * aligned.step * aligned.value.shape[1]))

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


def _overshoot(free: FreeCurve) -> SampledCurve:
    """Return the largest excess of the ESF over its levels."""
    reach = jnp.linspace(1.0, 6.0, 11) * free_curve.line_width(free.shape)
    response = free_curve.edge_response(free, jnp.concatenate([-reach[::-1], reach]))
    excess = jnp.concatenate([-response.value[: reach.size], response.value[reach.size :] - 1])
    most = jnp.argmax(excess)
    return SampledCurve(excess[most], response.std[most])


def _lens_fit(
    cells: EdgeCells, at: EdgeModel, noise: Noise, structure: free_fit.Structure, seen: LensAtEdge, excess: jax.Array
) -> LensFit:
    """Read everything off a fitted family of lenses."""
    parameters = at.state.profile
    weight = cells.pixels / noise.variance(at.value)
    covariance = excess * scaled_inverse((at.design * weight) @ at.design.T)
    lens_covariance = covariance[LINEAR:, LINEAR:]

    def response(f: jax.Array) -> SampledCurve:
        value, slopes = _with_slopes(lambda p: seen.mtf(p, f), parameters)
        return SampledCurve(value, jnp.sqrt(jnp.maximum((slopes @ lens_covariance * slopes).sum(-1), 0.0)))

    numbers, by = _with_slopes(seen.lens.numbers, parameters)
    mtf = response(jnp.asarray(FREQUENCIES))
    return LensFit(
        state=at.state,
        covariance=covariance,
        chi2=(weight * (cells.value - at.value) ** 2).sum(),
        degrees=(cells.pixels > 0).sum() - parameters.size - LINEAR,
        structure=structure,
        numbers=numbers,
        numbers_covariance=by @ lens_covariance @ by.T,
        expected=at.value,
        mtf=mtf,
        mtf50=free_curve.half_frequency(mtf.value, response),
    )


def _with_slopes(function, at: jax.Array):  # type: ignore[no-untyped-def]
    """Return a function's value and its derivatives."""
    return function(at), jax.jacfwd(function)(at)
