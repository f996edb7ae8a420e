"""Error propagation of the fit against refitting, and against many draws of noise."""

import numpy as np
import pytest

from matcam.forward.cells import CellPixels
from matcam.inverse import lobe_errors

RNG = np.random.default_rng(7)
C, S, N, K = 2, 3, 14, 3


@pytest.fixture
def problem():
    """A small linear model: value = A_cs m_s + sum_k g_k G_k + noise; returns weights, record, derivatives."""
    return RNG.uniform(0.5, 2, (C, S, N)), RNG.uniform(0.1, 1, (S, N)), RNG.standard_normal((K, C, S, N))


def refit(weights, record, derivatives, values):
    """All amplitudes and shared numbers by one big least-squares problem."""
    columns = [d.ravel() for d in derivatives]
    for c in range(C):
        for s in range(S):
            column = np.zeros((C, S, N))
            column[c, s] = record[s]
            columns.append(column.ravel())
    root = np.sqrt(weights).ravel()
    solution = np.linalg.lstsq(np.stack(columns, -1) * root[:, None], values.ravel() * root, rcond=None)[0]
    return solution[K:].reshape(C, S), solution[:K]


def test_reaction_is_that_of_a_full_refit(problem):
    maps = lobe_errors.sensitivity(*problem)
    for _ in range(3):
        change = RNG.standard_normal((C, S, N))
        amplitude, shared = lobe_errors.reaction(maps, change)
        expected_amplitude, expected_shared = refit(*problem, change)
        np.testing.assert_allclose(amplitude, expected_amplitude, atol=1e-12)
        np.testing.assert_allclose(shared, expected_shared, atol=1e-12)


def test_a_number_that_is_not_felt_is_held(problem):
    weights, record, derivatives = problem
    derivatives[1] = 0
    maps = lobe_errors.sensitivity(weights, record, derivatives)
    assert np.all(maps.to_shared[1] == 0)
    assert np.all(np.isfinite(maps.to_shared))


def test_a_strong_prior_holds_too(problem):
    weights, record, derivatives = problem
    maps = lobe_errors.sensitivity(weights, record, derivatives, np.diag([0, 1e12, 0]))
    assert np.abs(maps.to_shared[1]).max() < 1e-9
    assert np.abs(maps.to_shared[0]).max() > 1e-3


def test_covariance_counts_shared_pixels_once(problem):
    """100,000 draws of pixel noise, cells being means of two pixels, against the formula."""
    weights, record, derivatives = problem
    first, second = RNG.integers(0, 6, (2, S, N))
    second[:, 0] = first[:, 0]  # a cell that is one pixel
    std = RNG.uniform(0.5, 1.5, (C, S, N))
    maps = lobe_errors.sensitivity(weights, record, derivatives)
    covariance = lobe_errors.noise_covariance(maps, std, CellPixels(np.ones((S, N)), first, second))
    draws = RNG.standard_normal((100_000, C, S, 6))
    slices = np.arange(S)[:, None]
    change = std * (draws[:, :, slices, first] + draws[:, :, slices, second]) / 2
    shared = np.einsum("kcsn,xcsn->xk", maps.to_shared, change)
    amplitude = np.einsum("csn,xcsn->xcs", maps.to_amplitude, change) - np.einsum("kcs,xk->xcs", maps.taken, shared)
    sample = np.cov(np.concatenate([shared, amplitude.reshape(len(draws), -1)], 1).T)
    np.testing.assert_allclose(covariance.shared, sample[:K, :K], atol=0.02 * np.abs(sample).max())
    for c in range(C):
        block = slice(K + c * S, K + (c + 1) * S)
        np.testing.assert_allclose(covariance.amplitude[c], sample[block, block], atol=0.02 * np.abs(sample).max())
        np.testing.assert_allclose(covariance.cross[:, c], sample[:K, block], atol=0.02 * np.abs(sample).max())
