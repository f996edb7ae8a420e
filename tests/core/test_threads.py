"""What a command asks of threads, its own and the C library's."""

import subprocess
import sys

HEAP = """
import os, sys
os.environ.pop("MALLOC_ARENA_MAX", None)
from matcam.core.threads import import_behind, use_one_heap
use_one_heap()
import_behind("no.such.module", "colorsys")
import threading
for thread in threading.enumerate():
    if thread is not threading.main_thread():
        thread.join()
print("colorsys" in sys.modules)
"""


def test_imports_behind_the_work_miss_what_is_not_there_and_go_on():
    done = subprocess.run([sys.executable, "-c", HEAP], capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["True"], done.stderr
