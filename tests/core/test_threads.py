"""What a command asks of threads, its own and the C library's."""

import subprocess
import sys
import threading

import pytest

from matcam.core import threads

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


def test_work_behind_is_done_when_the_block_has_ended(monkeypatch):
    monkeypatch.setattr(threads, "available_cores", lambda: 2)
    done = []
    with threads.done_behind(lambda: done.extend(threads.in_order(abs, [-1, -2, -3, -4], 2))):
        pass
    assert done == [1, 2, 3, 4]


def test_an_error_in_the_block_ends_the_work_behind(monkeypatch):
    monkeypatch.setattr(threads, "available_cores", lambda: 2)
    begun, left = threading.Event(), threading.Event()
    done = []

    def slow(number):
        begun.set()
        assert left.wait(10)
        done.append(number)

    def block():
        with threads.done_behind(lambda: list(threads.in_order(slow, range(100), 2))):
            assert begun.wait(10)
            threading.Timer(0.2, left.set).start()  # the block's end waits for the item that the work is at
            raise ValueError("the block fails")

    with pytest.raises(ValueError, match="the block fails"):
        block()
    assert len(done) == 1


def test_work_behind_that_fails_fails_where_it_is_asked_for(monkeypatch):
    monkeypatch.setattr(threads, "available_cores", lambda: 2)
    with threads.done_behind(lambda: 1 / 0):
        pass


def test_one_core_does_nothing_behind(monkeypatch):
    monkeypatch.setattr(threads, "available_cores", lambda: 1)
    done = []
    with threads.done_behind(lambda: done.append(1)):
        pass
    assert done == []


def test_a_worker_of_a_run_uses_one_core(monkeypatch):
    monkeypatch.setattr(threads.os, "sched_getaffinity", lambda process: range(8), raising=False)
    cores = {}
    for limit in ("1", "3", "64", "0", "all"):
        monkeypatch.setenv("NPROC", limit)
        cores[limit] = threads.available_cores()
    assert cores == {"1": 1, "3": 3, "64": 8, "0": 1, "all": 8}
