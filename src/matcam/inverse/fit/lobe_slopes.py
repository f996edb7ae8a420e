"""A lobe's record and its derivatives: for one fit, or for the fits of several materials in one program.

A processor does one material after the other. A GPU is wider than that: there fits run in threads of one process, each as if it
were alone, and what they ask within a moment is computed together (`RecordBatch`).
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from contextvars import ContextVar
from typing import NamedTuple

import equinox as eqx
import numpy as np

from matcam.core.jax import jax, jnp
from matcam.inverse.fit import fit_parameters as parameters
from matcam.inverse.operator.lobe_operator import LobeOperator
from matcam.material.masking import Masking

_PATIENCE = 1e-3
"""Seconds that the first who asks waits for others."""

Pair = tuple[np.ndarray, np.ndarray]


@eqx.filter_jit
def lobe_and_slope(
    operator: LobeOperator, family: str, masking: Masking, q: jax.Array, size: int
) -> tuple[jax.Array, jax.Array]:
    """A of a lobe, (slices, cells), and its derivatives by q, (numbers, slices, cells). q: `size` numbers of the lobe, then the
    coordinates along the operator's axes."""

    def record(q: jax.Array) -> tuple[jax.Array, jax.Array]:
        value = operator.record(parameters.ndf_at(family, q[:size]), masking, q[size:])
        return value, value

    slope, value = jax.jacfwd(record, has_aux=True)(q)
    return value, jnp.moveaxis(slope, -1, 0)


@eqx.filter_jit
def _several(
    operator: LobeOperator, family: str, masking: Masking, q: jax.Array, size: int
) -> tuple[jax.Array, jax.Array]:
    return jax.vmap(lambda one: lobe_and_slope(operator, family, masking, one, size))(q)


def recorded(operator: LobeOperator, family: str, masking: Masking, q: np.ndarray, size: int) -> Pair:
    """`lobe_and_slope` as arrays, together with what other threads of a batch ask."""
    batch = _batch.get()
    if batch is not None:
        return batch.recorded(operator, family, masking, q, size)
    value, slope = lobe_and_slope(operator, family, masking, jnp.asarray(q), size)
    return np.asarray(value), np.asarray(slope)


class _Question(NamedTuple):
    operator: LobeOperator
    family: str
    masking: Masking
    size: int
    q: np.ndarray
    answer: Future[Pair]

    def is_like(self, other: _Question) -> bool:
        """Whether one program answers both."""
        same = (self.family, self.masking, self.size) == (other.family, other.masking, other.size)
        return same and self.operator is other.operator and self.q.size == other.q.size


class RecordBatch:
    """Answers up to `seats` questions of different threads in one program. A context; threads join it by `joined`."""

    def __init__(self, seats: int):
        self.seats = seats
        self.sizes: list[int] = []
        """How many questions each program answered."""
        self._asked: queue.SimpleQueue[_Question | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> RecordBatch:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._asked.put(None)
        self._thread.join()

    @contextmanager
    def joined(self) -> Iterator[None]:
        """The thread's questions go to the batch."""
        token = _batch.set(self)
        try:
            yield
        finally:
            _batch.reset(token)

    def recorded(self, operator: LobeOperator, family: str, masking: Masking, q: np.ndarray, size: int) -> Pair:
        """As the module's function."""
        question = _Question(operator, family, masking, size, q, Future())
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
                time.sleep(_PATIENCE)
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
        # always as many, so that one program serves; what fills it up is thrown away
        rows = np.stack([question.q for question in together] + [first.q] * (self.seats - len(together)))
        try:
            pair = _several(first.operator, first.family, first.masking, jnp.asarray(rows), first.size)
            values, slopes = (np.asarray(a) for a in pair)
        except Exception as error:
            for question in together:
                question.answer.set_exception(error)
            return
        self.sizes.append(len(together))
        for question, value, slope in zip(together, values, slopes, strict=False):
            question.answer.set_result((value, slope))


_batch: ContextVar[RecordBatch | None] = ContextVar("batch", default=None)
