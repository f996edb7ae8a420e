"""Records of the lobes from which a search starts. They depend only on the rig, so they are computed once."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from matcam.core.jax import jax, placed
from matcam.core.workspace import Workspace
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.inverse.fit.lobe_slopes import lobe_record
from matcam.inverse.operator.lobe_operator import LobeOperator


@dataclass(frozen=True)
class StartRecords:
    """Cache of the records of starts through an operator.

    Attributes:
        operator: operator of the rig at its specified parameters.
        workspace: store of the records for further materials and processes.
    """

    operator: LobeOperator
    workspace: Workspace

    def of(self, kind: LobeKind, starts: np.ndarray) -> np.ndarray:
        """Return the records at F = 1 of lobes at coordinates, (starts, slices, cells). starts: (starts, coordinates)."""
        key = f"records of starts\n{self._name}\n{kind}\n{starts.tobytes().hex()}"

        def make() -> dict[str, np.ndarray]:
            stated = np.zeros(len(self.operator.points))
            rows = [np.asarray(lobe_record(self.operator, kind, placed(np.concatenate([q, stated])))) for q in starts]
            return {"records": np.stack(rows)}

        folder = self.workspace.folder and self.workspace.folder / "starts"
        kept = Workspace(folder, files=_KEPT)
        return self.workspace.remember("records of starts", key, lambda: kept.store(key, make)["records"])

    @cached_property
    def _name(self) -> str:
        """Compute a name of the operator from a hash of its values, which determine the records."""
        numbers = hashlib.sha256()
        for leaf in jax.tree.leaves(self.operator):
            numbers.update(np.ascontiguousarray(leaf).tobytes())
        return numbers.hexdigest()


_KEPT = 40
"""Number of stored files of records, less than a megabyte each. A rig has five: one per family, with and without camera."""
