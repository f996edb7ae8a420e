"""All that was measured of one colour: edges by the stack, and MTF values; each with the picture that it comes from."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from matcam.calibration import joint_fit
from matcam.calibration.edge_result import EdgeMTF
from matcam.calibration.joint_fit import Edges, Values
from matcam.calibration.mtf_samples import MTFSamples
from matcam.calibration.profiles import LensModel

LensAt = Callable[[float | None], LensModel]
"""The family of lenses in a picture taken at an f-number; None: nobody knows."""


class EdgeTable(NamedTuple):
    """n measured edges, one row each: results over the field."""

    x: np.ndarray
    y: np.ndarray
    """(n,) px, middles."""
    angle: np.ndarray
    """(n,) rad, of the normal towards the bright side."""
    sigma: np.ndarray
    sigma_std: np.ndarray
    """(n,) px, of each edge's own Gaussian lens."""
    mtf50: np.ndarray
    mtf50_std: np.ndarray
    """(n,) cycles/px, free of a model."""
    mtf: np.ndarray
    mtf_std: np.ndarray
    """(n, 81) free of a model, at `curves.FREQUENCIES`."""
    source: np.ndarray
    """(n,) names of pictures."""


class Evidence:
    """Measurements of one colour, gathered picture by picture."""

    def __init__(self) -> None:
        self._stacks: list[tuple[EdgeMTF, str, float | None]] = []
        self.samples: list[MTFSamples] = []

    def add_edges(self, result: EdgeMTF, source: str, f_number: float | None) -> None:
        """Edges of a picture; those with problems are left out."""
        self._stacks.append((result, source, f_number))

    def add_samples(self, samples: MTFSamples) -> None:
        """A grating's, star's or grid's values."""
        self.samples.append(samples)

    def edges(self, lens_at: LensAt) -> Edges | None:
        """As the joint fit takes them."""
        parts = [
            joint_fit.edges_of(result, [lens_at(f_number)] * len(result))[0] for result, _, f_number in self._stacks
        ]
        return joint_fit.joined(parts) if parts else None

    def values(self, lens_at: LensAt) -> Values | None:
        """As the joint fit takes them."""
        return joint_fit.values_of(self.samples, [lens_at(s.aperture) for s in self.samples]) if self.samples else None

    def table(self) -> EdgeTable | None:
        """Of all edges without problems, in the order of `edges`."""
        rows = []
        for result, source, _ in self._stacks:
            good = np.flatnonzero([not problem for problem in result.problems])
            fit = result.parametric
            columns = (
                *result.place, result.angle, fit.values[:, 0], np.sqrt(fit.covariance[:, 0, 0]), result.mtf50,
                result.mtf50_std, result.mtf, result.mtf_std,
            )  # fmt: skip
            rows.append((*(np.asarray(column)[good] for column in columns), np.full(good.size, source)))
        return EdgeTable(*(np.concatenate(columns) for columns in zip(*rows, strict=True))) if rows else None

    def groups(self) -> list[str]:
        """For every measurement, in the order of the joint fit, what it was: picture and kind."""
        named = [
            f"{source} (edges)"
            for result, source, _ in self._stacks
            for _ in range(sum(not problem for problem in result.problems))
        ]
        return named + [f"{s.source} ({s.kind})" if s.source else s.kind for s in self.samples]

    def f_numbers(self) -> list[float | None]:
        """Of every measurement's picture."""
        return [f_number for _, _, f_number in self._stacks] + [s.aperture for s in self.samples]
