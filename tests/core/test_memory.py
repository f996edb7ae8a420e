"""Memory of a process that does many jobs."""

import gc
import subprocess
import sys
import weakref
from pathlib import Path

import pytest

from matcam.batch.executors import one_core_environment
from matcam.core import memory
from matcam.core.memory import free_for_the_next

_SCRIPT = """
import resource
import numpy as np

def job():
    return sum(float(np.full((90, 90, 180, 3), k).sum()) for k in range(8))

job()
before = resource.getrusage(resource.RUSAGE_SELF).ru_stime, resource.getrusage(resource.RUSAGE_SELF).ru_minflt
job()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before[1])
"""


class Ring:
    """An object that only a collection frees."""

    def __init__(self):
        self.own = self


@pytest.fixture
def unfrozen():
    frozen = gc.get_freeze_count()
    gc.unfreeze()
    memory._freeze.cache_clear()
    yield
    gc.unfreeze()
    if frozen:
        gc.freeze()


def test_what_a_job_leaves_is_freed(unfrozen):
    for _ in range(2):  # the first time all else is frozen
        left = weakref.ref(Ring())
        assert left() is not None
        free_for_the_next()
        assert left() is None
    assert gc.get_freeze_count() > 0


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="another C library has its own way")
def test_a_worker_asks_the_system_once_for_the_same_memory():
    ran = subprocess.run(
        [sys.executable, "-c", _SCRIPT], env=one_core_environment(), capture_output=True, text=True, check=True
    )
    assert int(ran.stdout) < 1000  # a table is 8,500 pages
