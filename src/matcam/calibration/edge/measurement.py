"""Model-free and parametric estimates of one edge or of many edges from rows of samples."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from matcam.calibration.edge import free_curve, free_fit, geometry
from matcam.calibration.edge.free_curve import FREQUENCIES, GHOSTS, CoreShape, FreeCurve, SampledCurve
from matcam.calibration.edge.geometry import EdgeCells, Rows
from matcam.calibration.edge.maximum_likelihood import (
    LINEAR,
    SHIFT,
    CurveStep,
    EdgeModel,
    Noise,
    Profile,
    State,
    curve_step,
    edge_model,
    scoring_step,
)
from matcam.calibration.edge.profiles import Gaussian, LensModel
from matcam.calibration.edge.start import find_curve, in_even_rows, side_levels
from matcam.calibration.edge.unexplained import estimated_noise, misfit_of, with_unexplained, without_outliers
from matcam.core import checks
from matcam.core.arrays import (
    changed,
    either,
    jacobian,
    last_of,
    repeated,
    without_warnings,
    xp,
)
from matcam.numerics.linalg import lifted_inverse
from matcam.numerics.normal import SIGNIFICANT

if TYPE_CHECKING:
    from matcam.core.jax import AnyArray, jax


class LensFit(NamedTuple):
    """Maximum likelihood fit of a lens model.

    Attributes:
        profile: (k,) fitted parameters of the lens.
        chi2: chi-square of the bins for the given or estimated noise.
        degrees: degrees of freedom: number of bins minus number of parameters.
        misfit_probability: probability of residuals at least as large as those of the fit if the model is correct,
            tested with the free curve.
        numbers: (k,) parameters of the lens, in the units of their names.
        numbers_covariance: (k, k) covariance of `numbers`.
        expected: (n,) model values of the bins.
        mtf: MTF at `FREQUENCIES`.
        mtf50: MTF50, cycles/px.
    """

    profile: jax.Array
    chi2: jax.Array
    degrees: jax.Array
    misfit_probability: jax.Array
    numbers: jax.Array
    numbers_covariance: jax.Array
    expected: jax.Array
    mtf: SampledCurve
    mtf50: SampledCurve


class EdgeFits(NamedTuple):
    """Model-free and parametric estimates of one edge.

    Positions are in px from the centre of the region. Values are in the units of the image.

    Attributes:
        curve: (CURVE,) coefficients of the edge.
        length: unit of length of the curve, as in `Rows`, px.
        slope: dx/dy of the least-squares line through the edge.
        slope_std: standard deviation of `slope`.
        angle: angle between the normal of the edge and the rows of the region, rad.
        crossing: number of rows that the edge crosses, away from the borders.
        noise: given or estimated noise.
        residual: standard deviation of single pixels about the fit, near the edge.
        parametric: fit of a lens model.
        free: model-free curve.
        mtf: MTF at `FREQUENCIES`.
        mtf50: MTF50, cycles/px.
        core_mtf: MTF without glare.
        core_mtf50: MTF50 without glare, cycles/px.
        overshoot: largest excess of the ESF beyond its levels, in units of the step.
        cells: means of the pixels.
        state: parameters of the Gaussian fit.
        shift: shift of the distances in `cells` to those of the free curve, px.
        excess: factor by which variances were increased, because the scatter of the bins exceeds the noise.
        outliers: number of pixels that were excluded.
        roughness: standard deviation of the position of the edge in single rows beyond the noise, px.
        misfit: standard deviation of the bins about the free curve beyond the noise, in units of the step.
    """

    curve: jax.Array
    length: jax.Array
    slope: jax.Array
    slope_std: jax.Array
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
    shift: jax.Array
    excess: jax.Array
    outliers: jax.Array
    roughness: jax.Array
    misfit: jax.Array


@without_warnings()
@checks.trusted()
def edge_fits(
    value: AnyArray,
    y: AnyArray,
    start: AnyArray,
    noise: Noise,
    half_width: AnyArray | np.float64,
    step: int,
    turns: int,
) -> EdgeFits:
    """Compute the model-free and the parametric estimate of the edge in one region.

    The parametric estimate uses a Gaussian lens. `value`, `y`, `start`, `step`: as in `geometry.Rows`. `noise`: noise of a
    pixel, whose unknown parameters are NaN and are estimated. `half_width`: half width of the pixel, px. `turns`: number of
    alternating fits of the profile and of the curve.
    """
    rows, half, lens = Rows.of(value, y, start, step), xp.asarray(half_width), Gaussian()
    first_curve, crossing = find_curve(rows)
    bare = geometry.aligned_rows(rows, first_curve)
    known = ~(xp.isnan(noise.gain) | xp.isnan(noise.read))
    phased = geometry.phased_rows(bare, first_curve)
    noise = estimated_noise(noise, phased)
    even_rows = in_even_rows(bare)
    aligned = without_outliers(phased._replace(rows=even_rows), noise)

    def turn(
        at: tuple[jax.Array, State], used: jax.Array
    ) -> tuple[Any, tuple[jax.Array, EdgeCells, EdgeModel, CurveStep]]:
        curve, state = at
        phased = geometry.phased_rows(aligned, curve)
        cells = geometry.edge_cells(phased)
        profile = lens.profile(xp.arctan(curve[1] / rows.length), half)
        state = _climb(cells, state._replace(used=used), lens, profile, noise)
        now = edge_model(cells, state, profile)
        moved = curve_step(phased, cells, now, noise)
        centred = state._replace(linear=changed(state.linear, SHIFT, 0.0))
        return (moved.curve, centred), (curve, cells, now, moved)

    even = free_fit.LIGHTS[0]
    levels = xp.append(xp.stack([side.mean() for side in side_levels(aligned)]), np.zeros(even.size - 2))
    # The last turn includes most orders of the light, so that uneven light does not bias the curve.
    uses = free_fit.LIGHTS[np.where(np.arange(turns) < turns - 1, 0, 3)]
    # The fit starts from a lens width of 0.6 px, whose logarithm is -0.5.
    curve, cells, at, moved = last_of(turn, (first_curve, State(levels, xp.array([-0.5]), even)), uses)
    # The slope of the least-squares line through a curve is its coefficient of order 1.
    slope, one = curve[1] / rows.length, xp.ones(())
    angle = xp.arctan(slope)
    profile = lens.profile(angle, half)
    shape = CoreShape(xp.exp(at.state.profile[0]), angle, half, radius=one, apart=one)

    def fitted(position: jax.Array, ghost: float) -> tuple[free_fit.LinearFit, tuple[jax.Array, jax.Array]]:
        """Fit the free curve without glare, and find the most probable glare.

        `position`: distance of a ghost, px. `ghost`: 1 if the fit includes a ghost, else 0.
        """
        fit = free_fit.linear_fit(cells, at, noise, shape._replace(apart=position), ghost)
        return fit, free_fit.glare_candidate(fit)

    first = fitted(shape.apart, 0.0)
    ghost, position = free_fit.ghost_found(*first, known)
    # With a ghost, the fit is repeated, because the first fit has treated the ghost as uneven light.
    linear, (log_radius, rise) = either(ghost, lambda _, at: fitted(at, 1.0), lambda same, _: same, first, position)
    # Fit the Gaussian lens in the selected light.
    chosen = at.state._replace(linear=at.state.linear * linear.used, used=linear.used)
    model = edge_model(cells, _climb(cells, chosen, lens, profile, noise), profile)
    # If the noise is unknown, the significance of glare follows from the residual with glare.
    left = (linear.weight * linear.left**2).sum() - rise
    glares = rise > free_fit.FOUND * xp.where(known, 1.0, xp.maximum(left / linear.degrees, 1.0))
    free = free_fit.fitted_curve(linear, log_radius, glares)
    # An estimate of the noise from neighbouring pixels may be too small. Therefore, a significant scatter about the free curve
    # increases all variances.
    scatter = (linear.chi2 - xp.where(glares, rise, 0.0)) / linear.degrees
    excess = xp.where(scatter < 1 + SIGNIFICANT * xp.sqrt(2 / linear.degrees), 1.0, scatter)
    free = free._replace(covariance=free.covariance * excess)
    misfit = misfit_of(linear, free, excess)
    widened = partial(with_unexplained, roughness=moved.roughness, misfit=misfit)

    def transfer(f: jax.Array) -> tuple[SampledCurve, SampledCurve]:
        total, core = free_curve.transfer(free, f)
        return widened(total, f), widened(core, f)

    mtf, core = transfer(xp.asarray(FREQUENCIES))
    return EdgeFits(
        curve=curve,
        length=rows.length,
        slope=slope,
        slope_std=xp.sqrt(excess * moved.covariance[1, 1]) / rows.length,
        angle=angle,
        crossing=crossing,
        noise=noise,
        residual=moved.residual,
        parametric=_lens_fit(cells, model, noise, linear, lens, angle, half, excess, widened),
        free=free,
        mtf=mtf,
        mtf50=free_curve.half_frequency(mtf.value, lambda f: transfer(f)[0]),
        core_mtf=core,
        core_mtf50=free_curve.half_frequency(core.value, lambda f: transfer(f)[1]),
        overshoot=_overshoot(free),
        cells=cells,
        state=model.state,
        shift=linear.levels[SHIFT],
        excess=excess,
        outliers=(even_rows.valid - aligned.valid).sum(),
        roughness=moved.roughness,
        misfit=misfit,
    )


@checks.trusted()
def lens_fit(found: EdgeFits, half_width: AnyArray | np.float64, lens: LensModel) -> LensFit:
    """Compute the parametric estimate with another lens model. `half_width`: half width of the pixel, px."""
    half = xp.asarray(half_width)
    profile, gaussian = (one.profile(found.angle, half) for one in (lens, Gaussian()))
    first = found.state._replace(profile=lens.start(found.state.profile[0]))
    tested = edge_model(found.cells, _climb(found.cells, first, lens, profile, found.noise, 12), profile)
    at = edge_model(found.cells, found.state, gaussian)
    ghost = (found.free.coefficients[GHOSTS] != 0).any()
    fit = free_fit.linear_fit(found.cells, at, found.noise, found.free.shape, ghost)
    widened = partial(with_unexplained, roughness=found.roughness, misfit=found.misfit)
    return _lens_fit(found.cells, tested, found.noise, fit, lens, found.angle, half, found.excess, widened)


@cache
def fits_program() -> Callable[..., EdgeFits]:
    """Compile `edge_fits` for many regions in parallel.

    The arguments are those of `edge_fits`, with regions (n, rows, columns), and y and start (n, rows). A command caches the
    program on disk, because tracing is slow.
    """
    from matcam.core.jax import jit_plainly, program_folder
    from matcam.core.programs import kept_program

    plain = jit_plainly(_fits_of_stack, runs="some", static=("step", "turns"))
    kept = kept_program(runs="some", returns=EdgeFits)(_fits_of_stack)
    return lambda *given: (plain if program_folder() is None else kept)(*given)


def _fits_of_stack(
    values: jax.Array, y: jax.Array, start: jax.Array, noise: Noise, half_width: jax.Array, step: int, turns: int
) -> EdgeFits:
    from matcam.core.jax import jax

    fit = partial(edge_fits, noise=noise, half_width=half_width, step=step, turns=turns)
    return jax.vmap(fit)(values, y, start)


def _climb(cells: EdgeCells, state: State, lens: LensModel, profile: Profile, noise: Noise, steps: int = 3) -> State:
    # Three steps suffice for a Gaussian lens, because the next turn continues the iteration.
    longest = np.array([np.inf] * SHIFT + [1.0, *lens.longest])
    return repeated(steps, partial(scoring_step, cells, profile=profile, noise=noise, longest=longest), state)


def _overshoot(free: FreeCurve) -> SampledCurve:
    distance = xp.linspace(1.0, 6.0, 11) * free_curve.line_width(free.shape)
    response = free_curve.edge_response(free, xp.concatenate([-distance[::-1], distance]))
    excess = xp.concatenate([-response.value[: distance.size], response.value[distance.size :] - 1])
    most = xp.argmax(excess)
    return SampledCurve(excess[most], response.std[most])


def _lens_fit(
    cells: EdgeCells,
    at: EdgeModel,
    noise: Noise,
    free: free_fit.LinearFit,
    lens: LensModel,
    angle: jax.Array,
    half_width: jax.Array,
    excess: jax.Array,
    widened: Callable[[SampledCurve, jax.Array], SampledCurve],
) -> LensFit:
    """Collect the results of a fitted lens model. `at`: fitted model. `widened`: `with_unexplained` for this edge."""
    parameters = at.state.profile
    weight = cells.pixels / noise.variance(at.value, cells.dim)
    lens_covariance = excess * lifted_inverse((at.design * weight) @ at.design.T)[LINEAR:, LINEAR:]
    numbers, by = _with_slopes(lens.numbers, parameters)

    def response(f: jax.Array) -> SampledCurve:
        value, slopes = _with_slopes(lambda p: lens.mtf(p, f, angle, half_width), parameters)
        std = xp.sqrt(xp.maximum((slopes @ lens_covariance * slopes).sum(-1), 0.0))
        return widened(SampledCurve(value, std), f)

    mtf = response(xp.asarray(FREQUENCIES))
    return LensFit(
        profile=parameters,
        chi2=(weight * (cells.value - at.value) ** 2).sum(),
        degrees=(cells.pixels > 0).sum() - parameters.size - LINEAR,
        misfit_probability=free_fit.misfit_probability(free, at),
        numbers=numbers,
        numbers_covariance=by @ lens_covariance @ by.T,
        expected=at.value,
        mtf=mtf,
        mtf50=free_curve.half_frequency(mtf.value, response),
    )


def _with_slopes(function, at: jax.Array):  # type: ignore[no-untyped-def]
    return function(at), jacobian(function, at)
