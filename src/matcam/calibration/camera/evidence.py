"""All that was measured of one colour: edges by the stack, and MTF values; each with the picture that it comes from.

Whether measurements agree with one another: by what each would change of the fit that they share (their scores).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from matcam.calibration.camera import joint_fit
from matcam.calibration.camera.joint_fit import Edges, JointFit, Values
from matcam.calibration.edge.edge_result import EdgeMTF
from matcam.calibration.edge.profiles import LensModel
from matcam.calibration.targets.mtf_samples import MTFSamples

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


_CLEAR, _LARGE = 5.0, 0.1  # standard deviations; relative: blurs that differ by more contradict each other
_DOUBT = 1e-3  # probability below which noise alone does not explain the scatter


def scatter(fit: JointFit) -> tuple[float, float]:
    """Chi2 per degree of freedom of the first number (the blur's scale), measurement by measurement, and the probability that
    noise alone does as much."""
    from scipy.special import chdtrc

    information, score = fit.shares.information[:, 0, 0], fit.shares.score[:, 0]
    told = information > 0
    degrees = max(int(told.sum()) - 1, 1)
    chi2 = float((score[told] ** 2 / information[told]).sum())
    return chi2 / degrees, float(chdtrc(degrees, chi2))


def covariance(fit: JointFit, prior: np.ndarray) -> np.ndarray:
    """Of the parameters: the noise's, or, where measurements scatter more than their noise, what their scatter says (the
    sandwich estimator, in which each measurement is one draw)."""
    _, probability = scatter(fit)
    count = len(fit.shares.score)
    if probability > _DOUBT or count < 4:
        return fit.covariance
    score = fit.shares.score - fit.shares.score.mean(0)
    spread = score.T @ score * count / (count - 1)
    wide = fit.covariance @ (spread + np.diag(prior)) @ fit.covariance
    # never below the noise's
    ratio = np.sqrt(np.maximum(np.diag(wide) / np.diag(fit.covariance), 1.0))
    grown = wide if (ratio > 1).all() else fit.covariance * np.outer(ratio, ratio)
    return (grown + grown.T) / 2


def contradiction(fit: JointFit, groups: Sequence[str]) -> str:
    """Which measurements contradict the others, in one line; empty if none do. groups: what each measurement is."""
    names = list(dict.fromkeys(groups))
    if len(names) < 2:
        return ""
    excess = max(scatter(fit)[0], 1.0)
    shifts, errors = [], []
    for name in names:
        of = np.array([group == name for group in groups])
        information = fit.shares.information[of, 0, 0].sum()
        shifts.append(fit.shares.score[of, 0].sum() / max(information, 1e-300))
        errors.append(np.sqrt(excess / max(information, 1e-300)))
    shift, error = np.array(shifts), np.array(errors)
    # between groups, the scatter that they cause themselves is no excuse: each is judged by its members
    error = error / np.sqrt(excess) * np.sqrt(_within(fit, groups, names, shift))
    found = np.array([_difference(shift, error, i) for i in range(len(names))])
    worst = int(np.argmax(np.abs(found[:, 0])))
    difference, clear = found[worst]
    if abs(difference) < _LARGE or abs(difference) < _CLEAR * clear:
        return ""
    rest = [name for i, name in enumerate(names) if i != worst]
    others = ", ".join(rest[:2]) + (f" and {len(rest) - 2} others" if len(rest) > 2 else "")
    return f"{names[worst]} sees a blur {difference:+.0%} against that of {others}"


def spread(table: EdgeTable | None) -> float:
    """Relative standard deviation of the edges' own sigmas, beyond their noise; 0 where noise explains it."""
    if table is None or table.x.size < 3:
        return 0.0
    relative = table.sigma_std / table.sigma
    mean = np.average(np.log(table.sigma), weights=relative**-2)
    variance = np.var(np.log(table.sigma), ddof=1, mean=mean) if table.x.size > 1 else 0.0
    return float(np.sqrt(max(variance - np.mean(relative**2), 0.0)))


def _difference(shift: np.ndarray, error: np.ndarray, one: int) -> tuple[float, float]:
    """Between one group and the mean of all others, and its standard deviation."""
    rest = np.arange(shift.size) != one
    weight = error[rest] ** -2 / (error[rest] ** -2).sum()
    return float(shift[one] - weight @ shift[rest]), float(np.hypot(error[one], (error[rest] ** -2).sum() ** -0.5))


def _within(fit: JointFit, groups: Sequence[str], names: Sequence[str], shift: np.ndarray) -> np.ndarray:
    """(groups,) chi2 per degree of freedom inside each, at least 1."""
    values = []
    for name, own in zip(names, shift, strict=True):
        of = np.array([group == name for group in groups])
        information = fit.shares.information[of, 0, 0]
        left = fit.shares.score[of, 0] - own * information
        values.append(max((left**2 / np.maximum(information, 1e-300)).sum() / max(of.sum() - 1, 1), 1.0))
    return np.array(values)
