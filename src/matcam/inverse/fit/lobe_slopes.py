"""Record of a lobe and its derivatives."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.jax import jax, placed
from matcam.core.programs import kept_program
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.inverse.fit.slopes_by_slice import slopes_by_slice
from matcam.inverse.operator.lobe_operator import LobeOperator


class RecordAndSlopes(NamedTuple):
    """Record of a lobe and its derivatives.

    Attributes:
        record: record at F = 1, 1/sr, (slices, cells).
        slopes: derivatives of the record with respect to the coordinates of the lobe, then of the rig, 1/sr,
            (coordinates, slices, cells).
    """

    record: np.ndarray
    slopes: np.ndarray


@kept_program
def lobe_record(operator: LobeOperator, kind: LobeKind, q: jax.Array) -> jax.Array:
    """Compute the record of a lobe at F = 1, 1/sr, (slices, cells).

    q: coordinates of the lobe, then of the rig.
    """
    return operator.record(kind.ndf(q[: kind.size]), kind.masking, q[kind.size :])


@kept_program
def _record_and_slopes(operator: LobeOperator, kind: LobeKind, q: jax.Array) -> tuple[jax.Array, jax.Array]:
    return slopes_by_slice(operator, kind, q)


def record_and_slopes(operator: LobeOperator, kind: LobeKind, q: np.ndarray) -> RecordAndSlopes:
    """Compute the record of a lobe and its derivatives.

    q: coordinates of the lobe, then of the rig, in the order of the axes of the operator.
    """
    value, slope = _record_and_slopes(operator, kind, placed(q))
    return RecordAndSlopes(np.asarray(value), np.asarray(slope))
