"""The evidence on one colour of a camera: all its measured edges and MTF values, each with the picture that it comes from."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from matcam.calibration.camera.joint_fit import Measurements, edge_measurements, value_measurements
from matcam.calibration.edge.edge_result import EdgeMTF
from matcam.calibration.edge.profiles import LensModel
from matcam.calibration.targets.mtf_samples import MTFSamples

LensAt = Callable[[float | None], LensModel]
"""The family of lenses in a picture taken at an f-number, None if that is not known."""

_LEAST_STD = 1e-4  # of an MTF value: no edge outweighs the others by more


class EdgeTable(NamedTuple):
    """Hold the results of n measured edges over the field, one row each.

    Attributes:
        x: (n,) px, of the middle.
        y: (n,) px.
        angle: (n,) direction of the normal towards the bright side, rad.
        sigma: (n,) standard deviation of each edge's own Gaussian lens, px.
        sigma_std: (n,) its standard deviation, px.
        mtf50: (n,) cycles/px, free of a model.
        mtf50_std: (n,) its standard deviation, cycles/px.
        mtf: (n, 81) MTF at `free_fit.FREQUENCIES`, free of a model.
        mtf_std: (n, 81) its standard deviation.
        source: (n,) names of pictures.
    """

    x: np.ndarray
    y: np.ndarray
    angle: np.ndarray
    sigma: np.ndarray
    sigma_std: np.ndarray
    mtf50: np.ndarray
    mtf50_std: np.ndarray
    mtf: np.ndarray
    mtf_std: np.ndarray
    source: np.ndarray

    @property
    def weights(self) -> np.ndarray:
        """Return the weights (n, 81) of the edges in their mean MTF, by their variances; their sum is 1."""
        weight = 1 / np.maximum(self.mtf_std, _LEAST_STD) ** 2
        return weight / weight.sum(0)

    @property
    def spread(self) -> float:
        """Return the relative standard deviation of the edges' sigmas beyond their noise; 0 where noise explains it."""
        if self.x.size < 3:
            return 0.0
        relative = self.sigma_std / self.sigma
        mean = np.average(np.log(self.sigma), weights=relative**-2)
        variance = np.var(np.log(self.sigma), ddof=1, mean=mean)
        return float(np.sqrt(max(variance - np.mean(relative**2), 0.0)))


class _Stack(NamedTuple):
    """Hold the edges of one picture, its name and its f-number."""

    edges: EdgeMTF
    source: str
    f_number: float | None

    @property
    def good(self) -> np.ndarray:
        """Return the indices of edges without problems."""
        return np.flatnonzero([not problem for problem in self.edges.problems])


class Evidence:
    """Hold the measurements of one colour, added picture by picture."""

    def __init__(self) -> None:
        self._stacks: list[_Stack] = []
        self._samples: list[MTFSamples] = []

    def add_edges(self, result: EdgeMTF, source: str, f_number: float | None) -> None:
        """Add the edges of a picture; those with problems do not count."""
        self._stacks.append(_Stack(result, source, f_number))

    def add_samples(self, *samples: MTFSamples) -> None:
        """Add MTF values of gratings, stars and dots."""
        self._samples += samples

    @property
    def f_numbers(self) -> list[float | None]:
        """Return the f-number of every measurement's picture."""
        return [stack.f_number for stack in self._stacks] + [s.aperture for s in self._samples]

    def measurements(self, lens_at: LensAt) -> Measurements:
        """Return everything as the joint fit takes it."""
        groups = [f"{stack.source} (edges)" for stack in self._stacks for _ in stack.good]
        groups += [f"{s.source} ({s.kind})" if s.source else s.kind for s in self._samples]
        return Measurements(
            edge_measurements([(stack.edges, lens_at(stack.f_number)) for stack in self._stacks]),
            value_measurements([(s, lens_at(s.aperture)) for s in self._samples]),
            tuple(groups),
        )

    def table(self) -> EdgeTable | None:
        """Return all edges without problems, in the order of the joint fit; None if there are no edges."""
        rows = []
        for stack in self._stacks:
            result, good = stack.edges, stack.good
            fit = result.parametric
            columns = (
                *result.place, result.angle, fit.values[:, 0], np.sqrt(fit.covariance[:, 0, 0]), result.mtf50,
                result.mtf50_std, result.mtf, result.mtf_std,
            )  # fmt: skip
            rows.append((*(np.asarray(column)[good] for column in columns), np.full(good.size, stack.source)))
        return EdgeTable(*(np.concatenate(columns) for columns in zip(*rows, strict=True))) if rows else None
