"""Threads: of the libraries beneath NumPy, which read their number from the environment as they are loaded, and our own."""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import os
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
U = TypeVar("U")

ONE_BLAS_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
"""Variables that keep linear algebra to the thread that asks for it.

Matrices of a fit have some thousand rows and twenty columns. OpenBLAS shares even those among all processors, and a thread that
waits for its share spins: on two busy processors a triangle of 5,000 rows takes 12 ms instead of 0.3 ms.
"""
_ARENA_MAX = -8  # M_ARENA_MAX of mallopt(3)


def use_one_blas_thread() -> None:
    """Keep this process's linear algebra to one thread, unless the user says otherwise or NumPy is loaded already.

    A program may choose this for its user; a library must not.
    """
    if "numpy" not in sys.modules:
        for name, value in ONE_BLAS_THREAD.items():
            os.environ.setdefault(name, value)


def use_one_heap() -> None:
    """Keep what all threads allocate in one heap, where the C library is glibc and the user has not said otherwise.

    Each thread that compiles would keep a heap of its own, with all that it once needed: a first correction 0.15 GiB.
    """
    if "MALLOC_ARENA_MAX" not in os.environ:
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).mallopt(_ARENA_MAX, 1)


def available_cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def import_behind(*modules: str) -> None:
    """Import modules in another thread, for what will ask for them later: XLA computes meanwhile, outside of Python's lock.

    What cannot be imported fails where it is asked for. A process that ends waits for the import: one that is torn down in a
    module of C++ would abort. modules: their full names.
    """

    def work() -> None:
        for name in modules:
            with contextlib.suppress(Exception):
                importlib.import_module(name)

    if not sys.modules.keys() >= set(modules):
        threading.Thread(target=work).start()


def in_order(work: Callable[[T], U], items: Sequence[T], workers: int) -> Iterator[U]:
    """Yield what `work` returns for each item, in their order, several at a time in threads.

    The first is done alone: it decides what the others are compared with, and compiles what they share. Threads suffice: files
    are decoded in processes of their own, and NumPy and JAX compute outside of Python's lock.

    Args:
        work: what is done with an item.
        items: any number.
        workers: items that are worked on at a time.

    Example:
        >>> list(in_order(abs, [-1, -2, -3], 2))
        [1, 2, 3]
    """
    yield from map(work, items[:1])
    if workers < 2 or len(items) < 3:
        yield from map(work, items[1:])
        return
    with ThreadPoolExecutor(workers) as pool:
        waiting = [pool.submit(work, item) for item in items[1 : workers + 1]]
        try:
            for number in range(1, len(items)):
                result = waiting.pop(0).result()
                if number + workers < len(items):  # no more than that many results lie about
                    waiting.append(pool.submit(work, items[number + workers]))
                yield result
        finally:
            for one in waiting:
                one.cancel()
