"""Many edges at once: the same program on ten of them side by side, over and over."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from matcam._jax import jax
from matcam.calibration import verdict
from matcam.calibration.edge_result import EdgeMTF, result_of
from matcam.calibration.maximum_likelihood import Noise
from matcam.calibration.measurement import fit_lens, measure_stack
from matcam.calibration.profiles import LensModel
from matcam.calibration.region import Frame, Region

AT_ONCE = 10
"""Edges that run side by side: they fit into the processor's cache."""


def measured(
    regions: Iterable[tuple[Region, list[str]]], model: str, lens: LensModel, noise: Noise, half_width: float, *,
    accept_sharpened: bool,
) -> EdgeMTF:  # fmt: skip
    """Result of all edges in regions of one shape, each of at most `AT_ONCE`, with what is wrong with each picture of
    theirs beforehand ("": nothing)."""
    half = np.float64(half_width)
    chunks, frames = [], []
    problems: list[str] = []
    for rows, flaws in regions:
        count = len(rows.value)
        # always as many at once, so that one compiled program serves every stack; what fills the last one up is thrown away
        y, start = (np.broadcast_to(a, (count, a.shape[-1])) for a in (rows.y, rows.start))
        value, y, start = (_filled(a) for a in (rows.value, y, start))
        found = measure_stack(value, y, start, noise, half, step=rows.step, turns=rows.turns)
        if model != "gaussian":
            found = found._replace(parametric=jax.vmap(fit_lens, in_axes=(0, None, None))(found, half, lens))
        # one after the other: programs that are queued on a processor compete for its threads
        found = jax.tree.map(np.asarray, found)
        chunks.append(jax.tree.map(lambda a: a[:count], found))  # noqa: B023
        refusals = verdict.refusals(chunks[-1], rows, accept_sharpened=accept_sharpened)
        problems += [flaw or refusal for flaw, refusal in zip(flaws, refusals, strict=True)]
        frames.append(Frame(*(np.broadcast_to(column, count) for column in rows.frame)))
    found = jax.tree.map(lambda *a: np.concatenate(a), *chunks)
    frame = Frame(*(np.concatenate(columns) for columns in zip(*frames, strict=True)))
    return result_of(found, frame, model, lens, half_width, tuple(problems))


def _filled(rows: np.ndarray) -> np.ndarray:
    return np.concatenate([rows, np.repeat(rows[:1], AT_ONCE - len(rows), axis=0)])
