"""How errors of the data and of the camera reach a fitted lobe.

The fit has, per channel c and slice s, an amplitude A_cs, and a few numbers g_k that all slices share (ln width, one
background per channel). To first order, a change e of the data changes them by

    dg = I^-1 sum W G~ e,      dA_cs = (sum W m e) / (sum W m^2) - sum_k taken_kcs dg_k,

G_k: derivative of the model by g_k; taken: the part of it that the amplitude can take up; G~: the rest; I: their
information matrix. Errors of pixels are independent, those of cells are not: scores are summed over the cells of a pixel
before they are squared. An error of the camera acts like a change of the data by minus the model's.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.forward.cells import CellPixels


class Sensitivity(NamedTuple):
    """Linear maps from the data to the fit. Shapes: k shared numbers, c channels, s slices, n cells."""

    to_shared: np.ndarray
    """(k, c, s, n)."""
    to_amplitude: np.ndarray
    """(c, s, n): of A, for fixed shared numbers."""
    taken: np.ndarray
    """(k, c, s): how much A falls when a shared number rises."""
    rest: np.ndarray
    """(k, c, s, n): G~, what of each derivative the amplitudes cannot take up."""


class Covariance(NamedTuple):
    """Covariances of amplitudes and shared numbers due to the noise of pixels."""

    amplitude: np.ndarray
    """(c, s, s)."""
    cross: np.ndarray
    """(k, c, s)."""
    shared: np.ndarray
    """(k, k)."""


def sensitivity(
    weights: np.ndarray, record: np.ndarray, derivatives: np.ndarray, prior: np.ndarray | None = None
) -> Sensitivity:
    """weights (c, s, n), record m (s, n), derivatives G (k, c, s, n) by the shared numbers; prior (k, k): what is known
    of them besides, as an information matrix.

    A shared number that the data do not feel gets no reaction at all: it is held, not fitted.
    """
    strength = (weights * record**2).sum(-1)
    to_amplitude = weights * record / np.where(strength > 0, strength, 1.0)[..., None]
    taken = np.einsum("csn,kcsn->kcs", to_amplitude, derivatives)
    rest = derivatives - taken[..., None] * record
    weighted = weights * rest
    information = np.einsum("kcsn,lcsn->kl", weighted, rest) + (0 if prior is None else prior)
    # scaled to a unit diagonal, so that pinv's cut-off means "not felt" whatever the units
    scale = np.sqrt(np.clip(np.diag(information), 0, None))
    unit = np.where(scale > 0, 1 / np.where(scale > 0, scale, 1.0), 0.0)
    inverse = np.linalg.pinv(information * np.outer(unit, unit), rcond=1e-10, hermitian=True) * np.outer(unit, unit)
    return Sensitivity(np.einsum("kl,lcsn->kcsn", inverse, weighted), to_amplitude, taken, rest)


def noise_covariance(maps: Sensitivity, pixel_std: np.ndarray, pixels: CellPixels) -> Covariance:
    """Covariance from the noise of pixels; pixel_std (c, s, n): standard deviation of a pixel at each cell."""
    k, c, s, _ = maps.to_shared.shape
    columns = np.concatenate([maps.to_shared, maps.to_amplitude[None]]) * pixel_std
    moments = np.zeros((s, c, k + 1, k + 1))
    for j in range(s):
        scores = columns[:, :, j] @ _cells_to_pixels(pixels.first[j], pixels.second[j])  # (k + 1, c, pixels)
        moments[j] = np.einsum("kcp,lcp->ckl", scores, scores)
    shared = moments[..., :k, :k].sum((0, 1))
    local = moments[..., k, k].T  # (c, s)
    cross = moments[..., :k, k].transpose(2, 1, 0)  # (k, c, s): of A for fixed shared numbers
    taken = maps.taken
    mixed = np.einsum("kcs,kct->cst", cross, taken)
    amplitude = np.einsum("kcs,kl,lct->cst", taken, shared, taken) - mixed - mixed.transpose(0, 2, 1)
    amplitude[:, np.arange(s), np.arange(s)] += local
    return Covariance(amplitude, cross - np.einsum("kl,lcs->kcs", shared, taken), shared)


def reaction(maps: Sensitivity, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(amplitudes (c, s), shared numbers (k,)): how the fit reacts to a change (c, s, n) of the data."""
    shared = np.einsum("kcsn,csn->k", maps.to_shared, change)
    amplitude = np.einsum("csn,csn->cs", maps.to_amplitude, change) - np.einsum("kcs,k->cs", maps.taken, shared)
    return amplitude, shared


def _cells_to_pixels(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(cells, pixels): each cell is the mean of two pixels, which may be one and the same."""
    numbers, place = np.unique(np.concatenate([first, second]), return_inverse=True)
    matrix = np.zeros((first.size, numbers.size))
    cells = np.arange(first.size)
    np.add.at(matrix, (cells, place[: first.size]), 0.5)
    np.add.at(matrix, (cells, place[first.size :]), 0.5)
    return matrix
