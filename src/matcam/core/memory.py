"""Memory that this process may still allocate, and release of memory after a job.

The memory is limited by the machine, by the control groups of the process, and by the address space of the process.
"""

from __future__ import annotations

import gc
import os
from functools import cache
from pathlib import Path

from matcam.core.errors import ArgumentError

_GROUPS = Path("/sys/fs/cgroup")


def available_memory() -> int:
    """Estimate the memory that this process may still allocate, bytes.

    Returns:
        The smallest of three values: the available memory of the machine, that of the control groups (versions 1 and 2) of
        this process, and the remaining address space of this process.
    """
    return max(min(_of_machine(), _of_process(), *(limit - used for limit, used in _groups())), 0)


def check_address_space() -> None:
    """Check that the libraries fit into the limit of address space (`ulimit -v`).

    With a smaller limit, a process would not end: OpenBLAS, which SciPy loads, repeats the allocation of a buffer for ever, and
    XLA waits for threads that could not be started.

    Raises:
        ArgumentError: the limit is too small.
    """
    # NumPy, SciPy and JAX require 2 GiB to load, compile and run the smallest command, with a margin; OpenBLAS requires
    # 40 MiB for the thread and the buffer of each further processor
    least = (2 << 30) + (40 << 20) * ((os.cpu_count() or 1) - 1)
    limit = _own_limit()
    if limit < least:
        raise ArgumentError(
            f"this process may use {limit / 1e9:.2f} GB of address space (ulimit -v), but NumPy, SciPy and JAX alone "
            f"need {least / 1e9:.2f} GB: raise the limit"
        )


def free_for_the_next() -> None:
    """Free the garbage of a job. The first call also excludes all existing objects from later garbage collections.

    About a million objects belong to the libraries and caches, and each collection would scan them. The freed memory is
    not returned to the operating system if the process has the environment of `one_core_environment`.
    """
    gc.collect()
    _freeze()


@cache
def _freeze() -> None:
    gc.freeze()


def _physical() -> int:
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # not a Unix
        return 1 << 33


def _of_machine() -> int:
    try:
        for line in Path("/proc/meminfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except (OSError, ValueError, IndexError):
        pass
    return _physical()


# The import is not in the function: a fork waits for ever for a module that a thread of its parent was importing.
try:
    from resource import RLIM_INFINITY, RLIMIT_AS, getrlimit
except ImportError:  # not a Unix

    def _own_limit() -> int:
        return 1 << 62
else:

    def _own_limit() -> int:
        limit = getrlimit(RLIMIT_AS)[0]
        return 1 << 62 if limit == RLIM_INFINITY else limit


def _of_process() -> int:
    limit = _own_limit()
    if limit >= 1 << 62:
        return limit
    try:
        used = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return limit
    return limit - used


def _groups() -> list[tuple[int, int]]:
    """Read the limit and the usage, bytes, of every control group of this process that has a limit."""
    try:
        lines = Path("/proc/self/cgroup").read_text(encoding="utf-8").splitlines()
    except OSError:
        return []
    found = []
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if controllers not in ("", "memory") and "memory" not in controllers.split(","):
            continue
        root = _GROUPS if not controllers else _GROUPS / "memory"
        names = (
            ("memory.max", "memory.current") if not controllers else ("memory.limit_in_bytes", "memory.usage_in_bytes")
        )
        folder = root / path.lstrip("/")
        for group in (folder, *folder.parents):
            if root not in (group, *group.parents):
                break
            limit = _number(group / names[0])
            used = None if limit is None else _number(group / names[1])  # most groups have no limit
            if limit is not None and used is not None:
                found.append((limit, used))
    return found


def _number(path: Path) -> int | None:
    try:
        text = path.read_text(encoding="utf-8").strip()
        return int(text) if text.isdigit() and int(text) < 1 << 60 else None
    except (OSError, ValueError):
        return None
