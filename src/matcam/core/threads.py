"""Threads: of the libraries beneath NumPy, which read their number from the environment as they are loaded, and our own."""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import os
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
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
        for item in items[1:]:
            _check_wanted()
            yield work(item)
        return
    with ThreadPoolExecutor(workers) as pool:
        waiting: list[Future[U]] = []
        left = iter(items[1:])
        try:
            for _ in range(1, len(items)):
                _check_wanted()
                # no more than that many results lie about
                waiting += [pool.submit(work, item) for item in islice(left, _at_a_time(workers) - len(waiting))]
                yield waiting.pop(0).result()
        finally:
            for one in waiting:
                one.cancel()


class _Behind(threading.local):
    """Say of a thread whose work is done behind another's whether that one still goes on, and whether it is still wanted."""

    busy: threading.Event | None = None
    dropped: threading.Event | None = None


_behind = _Behind()


class _DroppedError(Exception):
    """End work that nobody waits for any more."""


def _check_wanted() -> None:
    if _behind.dropped is not None and _behind.dropped.is_set():
        raise _DroppedError


def _at_a_time(workers: int) -> int:
    """Return how many items to work on at a time: one, while the work that goes before needs a core."""
    return 1 if _behind.busy is not None and _behind.busy.is_set() else workers


@contextlib.contextmanager
def done_behind(work: Callable[[], object]) -> Iterator[None]:
    """Do some work in another thread while the block runs, for what will ask for it later and finds it kept.

    Its `in_order` takes one core while the block runs, and all of them when it has ended. The block's end waits for it; after
    an error in the block it ends with the item that it is at. What fails in it fails again where it is asked for. On one core
    there is nothing to gain, and nothing is done.

    Args:
        work: a function without arguments.

    Example:
        >>> with done_behind(lambda: print("behind")):  # doctest: +SKIP
        ...     print("before")
    """
    if available_cores() < 2:
        yield
        return
    busy, dropped = threading.Event(), threading.Event()
    busy.set()

    def alone() -> None:
        _behind.busy, _behind.dropped = busy, dropped
        with contextlib.suppress(Exception):
            work()

    thread = threading.Thread(target=alone)
    thread.start()
    try:
        yield
    except BaseException:
        dropped.set()
        raise
    finally:
        busy.clear()
        thread.join()
