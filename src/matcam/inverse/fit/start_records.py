"""Records of the lobes from which a search starts. They depend only on the rig and are computed once for each rig."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from matcam.core.jax import jax
from matcam.core.workspace import Workspace
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.inverse.fit.lobe_slopes import lobe_record
from matcam.inverse.operator.lobe_operator import LobeOperator


@dataclass(frozen=True)
class StartRecords:
    """Cache of the records of the lobes from which a search starts.

    Attributes:
        operators: operators of the rig, one for each colour.
        workspace: store of the records, for other materials and processes.
    """

    operators: tuple[LobeOperator, ...]
    workspace: Workspace

    def of(self, kind: LobeKind, starts: np.ndarray) -> np.ndarray:
        """Compute the records of lobes at F = 1, 1/sr, (starts, operators, slices, cells).

        The parameters of the rig have their specified values.

        Args:
            kind: parametrisation of the lobes.
            starts: coordinates of the lobes, (starts, coordinates).
        """
        key = f"records of starts by colour\n{self._name}\n{kind}\n{starts.tobytes().hex()}"

        def make() -> dict[str, np.ndarray]:
            stated = np.zeros(len(self.operators[0].axes))
            found = [[lobe_record(one, kind, np.concatenate([q, stated])) for one in self.operators] for q in starts]
            return {"records": np.array(found)}

        folder = self.workspace.folder and self.workspace.folder / "starts"
        kept = Workspace(folder, files=_KEPT)
        return self.workspace.remember("records of starts", key, lambda: kept.store(key, make)["records"])

    @cached_property
    def _name(self) -> str:
        """Hash of the values of the operators, which identifies them in the cache."""
        numbers = hashlib.sha256()
        for leaf in jax.tree.leaves([operator.blocks for operator in self.operators]):
            numbers.update(np.ascontiguousarray(leaf).tobytes())
        return numbers.hexdigest()


_KEPT = 40
"""Largest number of stored files of records, each smaller than 1 MB. One rig has five files: families, and fits with and
without a camera, have separate files.
"""
