"""What a rig records of the lobes that a search begins with: it depends on the rig alone, so that it is computed once."""

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
    """Keep the records of starts through an operator.

    Attributes:
        operator: what the rig records of a lobe; its parameters are those that the rig states.
        workspace: keeps the records for the next material, and for the next process.
    """

    operator: LobeOperator
    workspace: Workspace

    def of(self, kind: LobeKind, starts: np.ndarray) -> np.ndarray:
        """Return the records at F = 1 of lobes at some coordinates, (starts, slices, cells). starts: (starts, coordinates)."""
        key = f"records of starts\n{self._name}\n{kind}\n{starts.tobytes().hex()}"

        def make() -> dict[str, np.ndarray]:
            stated = np.zeros(len(self.operator.axes))
            rows = [np.asarray(lobe_record(self.operator, kind, placed(np.concatenate([q, stated])))) for q in starts]
            return {"records": np.stack(rows)}

        folder = self.workspace.folder and self.workspace.folder / "starts"
        kept = Workspace(folder, files=_KEPT)
        return self.workspace.remember("records of starts", key, lambda: kept.store(key, make)["records"])

    @cached_property
    def _name(self) -> str:
        """Name the operator by its numbers: whatever made them, the records follow from them."""
        numbers = hashlib.sha256()
        for leaf in jax.tree.leaves(self.operator):
            numbers.update(np.ascontiguousarray(leaf).tobytes())
        return numbers.hexdigest()


_KEPT = 40
"""Files of records, less than a megabyte each: a rig has five, for the families that are tried with its camera and without."""
