"""F of every picture as a fit has it, and its errors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from matcam._jax import jax, jnp
from matcam.inverse import fit_parameters as parameters
from matcam.inverse.fit_problem import Problem

if TYPE_CHECKING:
    from matcam.inverse.material_fit import Solved


def strengths_of(problem: Problem, solved: Solved) -> tuple[np.ndarray, np.ndarray]:
    """F of every unit and slice and its standard deviation, the gain's share included where F is free."""
    layout = problem.layout
    strength = solved.model.strength.copy()
    if layout.fresnel != "free":
        variance = np.zeros_like(strength)
        for u in range(len(strength)):
            place = layout.unit(u)
            inner = slice(place.start, place.start + len(parameters.fresnel_names(layout.fresnel)))

            def curve(c: jax.Array) -> jax.Array:
                return parameters.reflectance_at(layout.fresnel, c).at(jnp.asarray(problem.theta_d))

            slope = np.asarray(jax.jacfwd(curve)(jnp.asarray(solved.p[inner])))
            variance[u] = np.einsum("sa,ab,sb->s", slope, solved.covariance[inner, inner], slope)
        return strength, np.sqrt(variance)
    own, taken = strength_errors(problem, solved)
    variance = own**2 + np.einsum("pus,pq,qus->us", taken, solved.covariance, taken)
    variance += (solved.noise.gain * strength) ** 2
    seen = problem.data.used.any(-1)
    return np.where(seen, strength, np.nan), np.where(seen, np.sqrt(variance), np.nan)


def strength_errors(problem: Problem, solved: Solved) -> tuple[np.ndarray, np.ndarray]:
    """Of strengths that are free in every slice: (their standard deviations, all else held, (units, slices); how they fall
    when the fit's numbers rise, (numbers, units, slices)). The covariance of a unit's strengths is diag(own^2) + taken'
    covariance taken. 0 where nothing was seen."""
    weighted = np.where(problem.data.used, solved.weight, 0.0) * solved.model.lobe
    power = np.maximum((weighted * solved.model.lobe).sum(-1), 1e-300)
    taken = (weighted * solved.model.derivative).sum(-1) / power
    seen = problem.data.used.any(-1)
    return np.where(seen, solved.model.strength_std, 0.0), np.where(seen, taken, 0.0)


def conditional(covariance: np.ndarray, known: slice) -> tuple[np.ndarray, np.ndarray]:
    """(covariance if the numbers at `known` were held, what their own uncertainty adds): both of the full shape."""
    cross = covariance[:, known]
    added = cross @ np.linalg.pinv(covariance[known, known], hermitian=True) @ cross.T
    return covariance - added, added
