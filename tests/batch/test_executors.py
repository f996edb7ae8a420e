"""What a worker's process is told before it loads anything."""

import subprocess
import sys
from pathlib import Path

import pytest

from matcam.batch.executors import one_core_environment

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


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="another C library has its own way")
def test_a_worker_asks_the_system_once_for_the_same_memory():
    ran = subprocess.run(
        [sys.executable, "-c", _SCRIPT], env=one_core_environment(), capture_output=True, text=True, check=True
    )
    assert int(ran.stdout) < 1000  # a table is 8,500 pages


def test_what_the_user_has_set_for_memory_stays(monkeypatch):
    assert int(one_core_environment()["MALLOC_TRIM_THRESHOLD_"]) > 1 << 31
    monkeypatch.setenv("MALLOC_TRIM_THRESHOLD_", "65536")
    assert one_core_environment()["MALLOC_TRIM_THRESHOLD_"] == "65536"
