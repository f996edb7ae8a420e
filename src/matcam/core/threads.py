"""Threads of this package and of the BLAS library.

The BLAS library reads its number of threads from the environment when NumPy is imported.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import os
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextvars import copy_context
from itertools import islice
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from concurrent.futures import Future

T = TypeVar("T")
U = TypeVar("U")

ONE_BLAS_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
"""Environment variables that restrict the BLAS library to the calling thread.

Matrices of a fit have some thousand rows and twenty columns. OpenBLAS distributes even such matrices over all processors with
spinning threads, which is much slower on busy processors.
"""


def use_one_blas_thread() -> None:
    """Restrict the BLAS library of this process to one thread.

    Environment variables that the user has set are kept. The function has no effect if NumPy is already loaded. Only
    programs may call it, because a library must not change the threads of its caller.
    """
    if "numpy" not in sys.modules:
        for name, value in ONE_BLAS_THREAD.items():
            os.environ.setdefault(name, value)


def use_one_heap() -> None:
    """Use one heap for all threads.

    Without this limit, each compiling thread keeps a heap of its peak size. The function has no effect without glibc,
    or if the user has set MALLOC_ARENA_MAX.
    """
    if "MALLOC_ARENA_MAX" not in os.environ:
        with contextlib.suppress(OSError, AttributeError):
            # -8 is M_ARENA_MAX of mallopt(3)
            ctypes.CDLL(None).mallopt(-8, 1)


def available_cores() -> int:
    """Count the cores that this process may use.

    The environment variable NPROC, which XLA also reads, is an upper limit. In the workers of a run this limit is 1.
    """
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    limit = os.environ.get("NPROC", "")
    return max(min(count, int(limit)), 1) if limit.isdecimal() else count


def import_behind(*modules: str) -> None:
    """Import modules in another thread, for later use.

    `modules` are full names of modules. XLA can compute during the import, because it releases the global interpreter
    lock. An error of the import is ignored here, and occurs again where the module is used. The end of the process
    waits for the import, because an exit during the import of a C++ module would abort.
    """

    def work() -> None:
        for name in modules:
            with contextlib.suppress(Exception):
                importlib.import_module(name)

    if not sys.modules.keys() >= set(modules):
        threading.Thread(target=work).start()


def in_order(work: Callable[[T], U], items: Sequence[T], workers: int) -> Iterator[U]:
    """Yield the results of items in order, computed in several threads.

    The first item runs alone, because it sets the reference for the others and compiles the functions that all items
    use. Threads suffice: files are decoded in separate processes, and NumPy and JAX release the global interpreter
    lock.

    Args:
        work: function of an item.
        items: arguments of `work`, one for each call.
        workers: largest number of items that are computed at the same time.

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
    from concurrent.futures import ThreadPoolExecutor  # a command that only prints its help does not need it

    with ThreadPoolExecutor(workers) as pool:
        waiting: list[Future[U]] = []
        left = iter(items[1:])
        try:
            for _ in range(1, len(items)):
                _check_wanted()
                # limits the number of waiting results
                waiting += [
                    pool.submit(copy_context().run, work, item)
                    for item in islice(left, _at_a_time(workers) - len(waiting))
                ]
                yield waiting.pop(0).result()
        finally:
            for one in waiting:
                one.cancel()


class _Behind(threading.local):
    """State of a background thread. The attributes are None in other threads.

    The event `busy` is set while the foreground work runs. The event `dropped` is set if the result is not required.
    """

    busy: threading.Event | None = None
    dropped: threading.Event | None = None


_behind = _Behind()


class _DroppedError(Exception):
    """Signal that ends background work whose result is not required."""


def _check_wanted() -> None:
    if _behind.dropped is not None and _behind.dropped.is_set():
        raise _DroppedError


def _at_a_time(workers: int) -> int:
    """Compute the number of items that may run at the same time.

    It is 1 while the foreground work requires a core, and `workers` otherwise.
    """
    return 1 if _behind.busy is not None and _behind.busy.is_set() else workers


@contextlib.contextmanager
def done_behind(work: Callable[[], object]) -> Iterator[None]:
    """Run work in a background thread during the block, to fill caches.

    During the block, `in_order` computes one item of this work at a time. After the block, it uses all workers. The end
    of the block waits for the work. After an error in the block, the work stops at the end of its current item. Errors
    of the work are ignored, and occur again where the result is used. If only one core is available, the work is
    skipped.

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
