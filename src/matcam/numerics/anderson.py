"""Acceleration of linearly converging iterations: Anderson mixing of the last steps."""

from __future__ import annotations

import numpy as np

_DEPTH = 5  # number of earlier steps that are mixed
_FLOOR = 1e-10  # share of the mean eigenvalue below which steps are linearly dependent


class AndersonMixing:
    """Anderson mixing of the last steps of an iteration.

    Gauss-Newton iterations neglect the second derivatives of a model. For large residuals, each step is therefore too
    long or too short. Anderson mixing corrects the step by means of the differences between the last steps.

    Source:
        Anderson, J. ACM 12 (1965); Walker and Ni, SIAM J. Numer. Anal. 49 (2011), type II.

    Example:
        >>> mixing, x = AndersonMixing(), np.array([1.0, 1.0])
        >>> for _ in range(4):
        ...     x = x + mixing.step(x, -np.array([0.3, 1.6]) * x, np.eye(2))
        >>> bool(abs(x).max() < 1e-6)
        True
    """

    def __init__(self) -> None:
        self._positions: list[np.ndarray] = []
        self._steps: list[np.ndarray] = []

    def step(self, position: np.ndarray, step: np.ndarray, metric: np.ndarray) -> np.ndarray:
        """Compute the accelerated step, (n,). The first step is returned unchanged.

        Args:
            position: current position of the iteration, (n,).
            step: step of the iteration at this position without acceleration, (n,).
            metric: matrix of the scalar product of steps, (n, n).
        """
        self._positions, self._steps = [*self._positions[-_DEPTH:], position], [*self._steps[-_DEPTH:], step]
        if len(self._steps) == 1:
            return step
        positions, steps = np.diff(self._positions, axis=0).T, np.diff(self._steps, axis=0).T
        power = steps.T @ metric @ steps
        power += _FLOOR * np.trace(power) / len(power) * np.eye(len(power))
        share = np.linalg.lstsq(power, steps.T @ metric @ step, rcond=None)[0]
        return step - (positions + steps) @ share

    def forget(self) -> None:
        self._positions, self._steps = [], []
