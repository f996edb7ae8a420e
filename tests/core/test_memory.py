"""Memory that a process gives back."""

import subprocess
import sys
from pathlib import Path

import pytest

_SCRIPT = """
from pathlib import Path
from matcam.core.memory import give_back_memory

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096

blocks = [bytes(1000) for _ in range(300_000)]
kept = blocks[::1000]  # what is still used lies between what is not
blocks = None
before = resident()
give_back_memory()
print(before - resident())
"""


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="this system does not say how much is resident")
def test_what_was_freed_goes_back_to_the_system():
    environment = {"PYTHONMALLOC": "malloc"}  # the C library's own, where arrays are
    ran = subprocess.run([sys.executable, "-c", _SCRIPT], env=environment, capture_output=True, text=True, check=True)
    assert int(ran.stdout) > 200e6
