"""How well a camera is known: the covariance of its parameters, and where it comes from.

Both travel with the camera into its profile, because a kernel without its uncertainty cannot correct anything honestly.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike

from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.jax import jax, jnp


class Uncertainty(eqx.Module):
    """Covariance of some of a camera's parameters; the others are taken as exact.

    names: as in `Camera.parameters()`, e.g. "optics.sigma_px". covariance: shape (n, n), in the units of the names.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    covariance: jax.Array

    def __init__(self, names: Iterable[str], covariance: ArrayLike):
        self.names = tuple(names)
        self.covariance = checks.number("covariance", covariance)
        n = len(self.names)
        if self.covariance.shape != (n, n):
            raise ArgumentError(f"covariance of {n} parameters must have shape ({n}, {n}), got {self.covariance.shape}")
        if len(set(self.names)) != n:
            raise ArgumentError(f"covariance names a parameter twice: {', '.join(self.names)}")
        matrix = np.asarray(self.covariance)
        scale = np.sqrt(np.maximum(np.diag(matrix), 0))
        tolerance = 1e-9 * np.outer(scale, scale) + 1e-300
        if np.any(np.diag(matrix) < 0) or np.any(np.abs(matrix - matrix.T) > tolerance):
            raise ArgumentError("covariance must be symmetric with variances >= 0 on its diagonal")
        correlation = matrix / np.where(scale > 0, scale, 1) / np.where(scale > 0, scale, 1)[:, None]
        if n and np.linalg.eigvalsh(correlation)[0] < -1e-9:
            raise ArgumentError("covariance is not positive semidefinite: some combination has a negative variance")

    @classmethod
    def of(cls, std: Mapping[str, float]) -> Uncertainty:
        """Independent parameters with these standard deviations."""
        for name, value in std.items():
            checks.within(f"standard deviation of {name}", value, 0, np.inf, open_high=True)
        return cls(std.keys(), np.diag([float(s) ** 2 for s in std.values()]))

    def check_names(self, parameters: Iterable[str]) -> None:
        """ArgumentError if a name is none of the camera's `parameters`."""
        known = set(parameters)
        for name in self.names:
            if name not in known:
                raise ArgumentError(
                    f"uncertainty names {name!r}, which this camera has not; it has {', '.join(sorted(known))}"
                )

    def std(self) -> dict[str, float]:
        """Standard deviations by name."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    def __repr__(self) -> str:
        return f"Uncertainty({self.names!r}, {jnp.asarray(self.covariance).tolist()!r})"


@dataclass(frozen=True)
class Provenance:
    """Where a camera profile comes from. All texts are free."""

    source: str = ""
    """What was measured or assumed, and how."""
    created: str = ""
    """ISO 8601 date."""
    software: str = ""
    notes: str = ""
