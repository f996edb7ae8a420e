"""The uncertainty of a camera: the covariance of its parameters, and where they come from.

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
    """State the covariance of a camera's parameters; parameters without one are exact.

    Args:
        names: of the parameters, as in `Camera.parameters()`, such as "optics.sigma_px"; (n,).
        covariance: in the units of the names, shape (n, n), symmetric, positive semidefinite.

    Raises:
        ArgumentError: the shape does not fit, a name stands twice, or this is no covariance.

    Example:
        >>> known = matcam.camera.Uncertainty.of({"optics.sigma_px": 0.02})
        >>> known.std()
        {'optics.sigma_px': 0.02}
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
        """Build the uncertainty of independent parameters from standard deviations.

        Args:
            std: standard deviation by name, in the unit of the name, >= 0.

        Raises:
            ArgumentError: a standard deviation is negative or not finite.
        """
        for name, value in std.items():
            checks.within(f"standard deviation of {name}", value, 0, np.inf, open_high=True)
        return cls(std.keys(), np.diag([float(s) ** 2 for s in std.values()]))

    def check_names(self, parameters: Iterable[str]) -> None:
        """Check that every name belongs to a camera.

        Args:
            parameters: names that the camera has.

        Raises:
            ArgumentError: a name is not among them.
        """
        known = set(parameters)
        for name in self.names:
            if name not in known:
                raise ArgumentError(
                    f"uncertainty names {name!r}, which this camera has not; it has {', '.join(sorted(known))}"
                )

    def std(self) -> dict[str, float]:
        """Return the standard deviations by name, in the units of the names."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    def __repr__(self) -> str:
        return f"Uncertainty({self.names!r}, {jnp.asarray(self.covariance).tolist()!r})"


@dataclass(frozen=True)
class Provenance:
    """Tell where a camera profile comes from; all texts are free.

    Attributes:
        source: measurement or assumption behind the profile. Default: "".
        created: ISO 8601 date. Default: "", the day on which the profile is written.
        software: program and version. Default: "", this one.
        notes: anything else. Default: "".

    Example:
        >>> matcam.camera.Provenance(source="slanted edges, f/8").source
        'slanted edges, f/8'
    """

    source: str = ""
    created: str = ""
    software: str = ""
    notes: str = ""
