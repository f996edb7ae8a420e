"""Parameters of a camera by name, their covariance, and the origin of a camera.

The name of a parameter is its path in the camera profile, such as "optics.core.sigma_px". It ends in the unit of the
parameter. The name of a parameter without unit is, for example, "optics.mtf[3]".
"""

from __future__ import annotations

import operator
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from matcam.core import checks
from matcam.core.arrays import is_concrete, xp
from matcam.core.arrays.module import Module, replaced, static_field
from matcam.core.errors import ArgumentError

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import jax

_NAME = re.compile(r"((?:\w+\.)+)(\w+?)(?:\[(\d+)\])?")


class Uncertainty(Module):
    """Covariance of parameters of a camera; the other parameters are exact.

    Args:
        names: n names of parameters, as in `Camera.parameters()`, such as "optics.sigma_px".
        covariance: covariance of the parameters, in products of the units in their names, shape (n, n), symmetric,
            positive semidefinite.

    Raises:
        ArgumentError: the shape is not (n, n), a name occurs twice, or the matrix is not finite, symmetric and positive
            semidefinite.

    Example:
        >>> known = matcam.camera.Uncertainty.of({"optics.sigma_px": 0.02})
        >>> known.std()
        {'optics.sigma_px': 0.02}
    """

    names: tuple[str, ...] = static_field()
    covariance: jax.Array

    def __init__(self, names: Iterable[str], covariance: ArrayLike):
        self.names = tuple(names)
        self.covariance = checks.number("covariance", covariance)
        n = len(self.names)
        if self.covariance.shape != (n, n):
            raise ArgumentError(f"covariance of {n} parameters must have shape ({n}, {n}), got {self.covariance.shape}")
        if len(set(self.names)) != n:
            raise ArgumentError(f"names must differ from each other, got {', '.join(self.names)}")
        if not is_concrete(covariance):
            return
        matrix = np.asarray(covariance, dtype=float)  # as given, because inside jax.jit its copy is a tracer
        scale = np.sqrt(np.maximum(np.diag(matrix), 0))
        tolerance = 1e-9 * np.outer(scale, scale) + 1e-300
        if np.any(np.diag(matrix) < 0) or np.any(np.abs(matrix - matrix.T) > tolerance):
            raise ArgumentError("covariance must be symmetric with variances >= 0 on its diagonal")
        correlation = matrix / np.where(scale > 0, scale, 1) / np.where(scale > 0, scale, 1)[:, None]
        if n and np.linalg.eigvalsh(correlation)[0] < -1e-9:
            raise ArgumentError(
                "covariance is not positive semidefinite, because a combination of parameters has a negative variance: "
                "check the elements off the diagonal"
            )

    @classmethod
    def of(cls, std: Mapping[str, float]) -> Uncertainty:
        """Build the uncertainty of independent parameters from standard deviations.

        Args:
            std: standard deviation by the name of the parameter, in the unit in this name, >= 0.

        Raises:
            ArgumentError: `std` is not a mapping, or a standard deviation is negative or not finite.
        """
        if not isinstance(std, Mapping):
            raise ArgumentError(f"std must map names to standard deviations, got {' '.join(repr(std).split())[:60]}")
        for name, value in std.items():
            checks.within(f"standard deviation of {name}", value, 0, np.inf, open_high=True)
        return cls(std.keys(), np.diag([float(s) ** 2 for s in std.values()]))

    def check_names(self, parameters: Iterable[str]) -> None:
        """Check that a camera has all parameters in `names`.

        Args:
            parameters: names of all parameters of the camera.

        Raises:
            ArgumentError: a name is not in `parameters`.
        """
        known = set(parameters)
        for name in self.names:
            if name not in known:
                raise ArgumentError(
                    f"uncertainty contains the parameter {name!r}, but the camera has only {', '.join(sorted(known))}: "
                    "use these names"
                )

    def std(self) -> dict[str, float]:
        """Compute the standard deviation of each parameter, by name.

        The unit is the unit in the name of the parameter.
        """
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    def __repr__(self) -> str:
        if not is_concrete(self.covariance):
            return f"Uncertainty({self.names!r}, {self.covariance!s})"
        covariance = np.asarray(self.covariance)
        if not np.any(covariance - np.diag(np.diag(covariance))):
            return f"Uncertainty.of({self.std()!r})"
        pairs = ", ".join(f"{name} ± {std:.3g}" for name, std in self.std().items())
        return f"<Uncertainty: {pairs}, correlated>"


@dataclass(frozen=True)
class Provenance:
    """Origin of a camera profile; all fields are free text.

    Attributes:
        source: measurement or assumption behind the profile. Default: "".
        created: ISO 8601 date. Default: "", replaced by the current date in the profile.
        software: program and version. Default: "", replaced by matcam and its version in the profile.
        notes: further remarks. Default: "".

    Example:
        >>> matcam.camera.Provenance(source="slanted edges, f/8").source
        'slanted edges, f/8'
    """

    source: str = ""
    created: str = ""
    software: str = ""
    notes: str = ""


def parameters_of(part: str, module: Any) -> dict[str, jax.Array]:
    """List the parameters of a lens or pixel, including those of inner lenses, by name.

    part: path of the lens or pixel in the camera, such as "optics" or "optics.core".
    """
    named = {}
    for field, value in fields_of(module).items():
        if isinstance(value, Module):
            named.update(parameters_of(f"{part}.{field}", value))
        elif isinstance(value, tuple):
            continue  # the frequencies of a sampled curve are exact
        elif xp.ndim(value):
            named.update({f"{part}.{field}[{i}]": value[i] for i in range(value.size)})
        else:
            named[f"{part}.{field}"] = value
    return named


def replace_parameters(part: str, module: Any, values: Mapping[str, Any]) -> Any:
    """Replace parameters of a lens or pixel. The new values may be traced by JAX.

    part: "optics" or "pixel". module: the lens or pixel. values: new values by name; names of other parts are ignored.
    """
    for name, value in values.items():
        found = _NAME.fullmatch(name)
        if found is None or found[1].split(".")[0] != part:
            continue
        path = _path(module, found[1].split(".")[1:-1], found[2])
        new = xp.asarray(value, dtype=xp.float64)
        if found[3] is not None:
            old = operator.attrgetter(path)(module)
            new = xp.where(np.arange(old.size) == int(found[3]), new, old)
        module = replaced(module, path, new)
    return module


def rebuilt(module: Any) -> Any:
    """Construct a lens or pixel again from its values, so that its constructor checks them."""
    values = fields_of(module).values()
    return type(module)(*(rebuilt(value) if isinstance(value, Module) else value for value in values))


def fields_of(module: Any) -> dict[str, Any]:
    """List the values of the profile fields of a lens or pixel by name.

    The values are scalars, curves and inner lenses. The names include the units.
    """
    return {field: operator.attrgetter(path)(module) for field, path in module.profile_fields.items()}


def _path(module: Any, inner: list[str], field: str) -> str:
    """Convert the names of inner lenses and of a field in a profile to the path of an attribute, such as "core.sigma"."""
    steps = []
    for name in (*inner, field):
        steps.append(module.profile_fields[name])
        module = operator.attrgetter(steps[-1])(module)
    return ".".join(steps)
