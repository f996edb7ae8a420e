"""A lobe's record and its derivatives: for one fit, or for the fits of several materials in one program.

A processor does one material after the other. A GPU is wider than that. There fits run in threads of one process, each as if it
were alone, and what they ask within a moment is computed together (`RecordBatch`).
"""

from __future__ import annotations

import queue
import threading
import time
from concurrent.futures import Future
from typing import NamedTuple

import numpy as np

from matcam.core.jax import jax, placed
from matcam.core.programs import kept_program
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.inverse.fit.slopes_by_slice import slopes_by_slice
from matcam.inverse.operator.lobe_operator import LobeOperator

_WINDOW = 1e-3
"""Batching window, seconds: the first question waits this long for others."""


class RecordAndSlopes(NamedTuple):
    """A lobe's record and how it changes.

    Attributes:
        record: (slices, cells), 1/sr at F = 1.
        slopes: (parameters, slices, cells), by the lobe's coordinates and then by the rig's.
    """

    record: np.ndarray
    slopes: np.ndarray


@kept_program
def lobe_record(operator: LobeOperator, kind: LobeKind, q: jax.Array) -> jax.Array:
    """Return the record of a lobe, (slices, cells). q: coordinates of the lobe, then of the rig."""
    return operator.record(kind.ndf(q[: kind.size]), kind.masking, q[kind.size :])


@kept_program
def _record_and_slopes(operator: LobeOperator, kind: LobeKind, q: jax.Array) -> tuple[jax.Array, jax.Array]:
    return slopes_by_slice(operator, kind, q)


@kept_program
def _several(operator: LobeOperator, kind: LobeKind, rows: jax.Array) -> tuple[jax.Array, jax.Array]:
    return jax.vmap(lambda q: _record_and_slopes(operator, kind, q))(rows)


def record_and_slopes(
    operator: LobeOperator, kind: LobeKind, q: np.ndarray, batch: RecordBatch | None = None
) -> RecordAndSlopes:
    """Return a lobe's record and slopes.

    q: coordinates of the lobe, then those along the operator's axes. batch: computes it together with what other threads ask.
    """
    if batch is not None:
        return batch.record_and_slopes(operator, kind, q)
    value, slope = _record_and_slopes(operator, kind, placed(q))
    return RecordAndSlopes(np.asarray(value), np.asarray(slope))


class _Question(NamedTuple):
    operator: LobeOperator
    kind: LobeKind
    q: np.ndarray
    answer: Future[RecordAndSlopes]

    def is_like(self, other: _Question) -> bool:
        """Say whether one program answers both."""
        return self.kind == other.kind and self.operator is other.operator and self.q.size == other.q.size


class RecordBatch:
    """Answer up to `seats` questions of different threads in one program.

    The batch is a context, which fits reach through their workspace (`Workspace.with_batch`).

    Attributes:
        seats: most questions that one program answers.
        sizes: how many questions each program answered.
    """

    def __init__(self, seats: int):
        self.seats = seats
        self.sizes: list[int] = []
        self._asked: queue.SimpleQueue[_Question | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> RecordBatch:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._asked.put(None)
        self._thread.join()

    def record_and_slopes(self, operator: LobeOperator, kind: LobeKind, q: np.ndarray) -> RecordAndSlopes:
        """Ask for a record, and wait for it."""
        question = _Question(operator, kind, q, Future())
        self._asked.put(question)
        return question.answer.result()

    def _serve(self) -> None:
        waiting: list[_Question] = []
        open_ = True
        while open_ or waiting:
            if not waiting:
                first = self._asked.get()
                if first is None:
                    return
                waiting.append(first)
                time.sleep(_WINDOW)
            while not self._asked.empty():
                more = self._asked.get()
                if more is None:
                    open_ = False
                else:
                    waiting.append(more)
            together = [question for question in waiting if question.is_like(waiting[0])][: self.seats]
            answered = {id(question) for question in together}
            waiting = [question for question in waiting if id(question) not in answered]
            self._answer(together)

    def _answer(self, together: list[_Question]) -> None:
        first = together[0]
        # always as many rows, so that one program serves; those that fill it up are thrown away
        rows = np.stack([question.q for question in together] + [first.q] * (self.seats - len(together)))
        try:
            pair = _several(first.operator, first.kind, placed(rows))
            values, slopes = (np.asarray(a) for a in pair)
        except Exception as error:
            for question in together:
                question.answer.set_exception(error)
            return
        self.sizes.append(len(together))
        for question, value, slope in zip(together, values, slopes, strict=False):
            question.answer.set_result(RecordAndSlopes(value, slope))
