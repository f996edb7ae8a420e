"""Record of many positions in blocks whose plans fit into memory.

A wide lens requires thousands of nodes for each position. The plan of a whole table may then occupy 50 GB.
"""

from __future__ import annotations

import numpy as np

from matcam.core.jax import jax, jnp
from matcam.forward.integral.blur import Imaging
from matcam.forward.integral.blur_groups import groups_of
from matcam.forward.sampler.plan import RecordPlan, RecordPositions, record_plan
from matcam.forward.sampler.record import record
from matcam.material.material import Material

_POSITIONS = 3 << 20
"""Positions of a block for a lens of one Gaussian, whose plan occupies about 1 kB for each. More than any table has."""
_KEPT_BYTES = 2e9
"""Largest total size of the kept plans, bytes. The plans of further blocks are computed again for each material."""


class PlannedBlocks:
    """Positions to record, in blocks, and the plans of the first blocks.

    Args:
        imaging: sample, blur and inverse distance of the lamp.
        positions: positions to record.
        finest: narrowest scale of the lobe, rad.
        elongation: elongation of the lobe, no unit, see `record_plan`. Default: 1, an isotropic lobe.
        kept: True to keep plans for further materials. Default: True.
    """

    def __init__(
        self,
        imaging: Imaging,
        positions: RecordPositions,
        finest: float,
        elongation: float = 1.0,
        *,
        kept: bool = True,
    ):
        self._imaging = jax.lax.stop_gradient(imaging)
        self._positions, self._lobe = positions, (finest, elongation)
        # both the terms of a lens and the width of the widest of them grow with the number of its scales
        size = max(1, _POSITIONS // len(groups_of(self._imaging.blur, imaging.sample)) ** 2)
        self._starts = range(0, max(positions.x.size, 1), size)
        self._kept = dict[int, RecordPlan]() if kept else None

    def record(self, material: Material, imaging: Imaging, turning: jax.Array | float = 0.0) -> jax.Array:
        """Compute the record of a material, see `record`, 1/sr, (positions, channels)."""
        parts = [record(material, imaging, self._plan(start), turning) for start in self._starts]
        return parts[0] if len(parts) == 1 else jnp.concatenate(parts)

    def _plan(self, start: int) -> RecordPlan:
        kept = self._kept
        if kept is not None and start in kept:
            return kept[start]
        block = self._positions.at(np.arange(start, min(start + self._starts.step, self._positions.x.size)))
        plan = record_plan(self._imaging, block, *self._lobe)
        if kept is not None and (not kept or sum(map(_bytes, (*kept.values(), plan))) < _KEPT_BYTES):
            kept[start] = plan
        return plan


def _bytes(plan: RecordPlan) -> int:
    return sum(
        np.asarray(leaf).nbytes
        for leaf in jax.tree.leaves([(part.frames, part.arcs, part.even_arcs) for part in plan.parts])
    )
