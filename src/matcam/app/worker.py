"""Work beside the page: the newest request is done next, older ones that nobody has begun are forgotten.

A thread computes, so that the server reads what the browser sends meanwhile: a slider's last value is there when the thread
asks. A result is shown before the next request is begun, so that neither requests nor results queue up. Moves that have arrived
already are read before any of them is computed: they are a few milliseconds apart at most.
"""

from __future__ import annotations

import math
import threading
import time
import traceback
from collections.abc import Callable
from typing import Any

from bokeh.document import Document

from matcam.core.errors import MatcamError

_SHOWN_WITHIN = 5.0  # s; a page that has gone shows nothing

DRAINED = {"after": 0.004, "within": 0.05}
"""Times, s, within which a slider's moves that wait to be read overtake each other (see `Newest.ask`)."""

THREAD = "matcam-app"
"""Name of the threads that compute."""


class Newest:
    """Do the newest of the jobs that are asked for, one at a time.

    Args:
        document: the page's document; results are shown under its lock.
        complain: shows one line about a job that failed.
    """

    def __init__(self, document: Document, complain: Callable[[str], None]):
        self._document = document
        self._complain = complain
        self._wake = threading.Condition()
        self._job: tuple[Callable[[], Any], Callable[[Any], None]] | None = None
        self._first = self._due = 0.0
        self._ended = False
        self.busy = False
        self._thread: threading.Thread | None = None

    def ask(
        self, work: Callable[[], Any], show: Callable[[Any], None], after: float = 0.0, within: float = math.inf
    ) -> None:
        """Ask for work; a job that has not begun is replaced.

        Args:
            work: what to do.
            show: gets the result in the page.
            after: time for which nothing else is asked before the work begins, s. Default: 0.
            within: time after which the newest job begins though others keep coming, s. Default: infinite.
        """
        now = time.monotonic()
        with self._wake:
            if self._job is None:
                self._first = now
            due = min(now + after, self._first + within)
            waits = self._job is not None and self._due <= due
            self._job, self._due = (work, show), due
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, daemon=True, name=THREAD)
                self._thread.start()
            if not waits:  # a thread that waits for an earlier time finds this job then
                self._wake.notify()

    def overtaken(self) -> bool:
        """Tell whether another job waits: a long one may stop."""
        return self._ended or self._job is not None

    def close(self) -> None:
        """Take no more work; what runs is not shown."""
        with self._wake:
            self._ended, self._job = True, None
            self._wake.notify()

    def show(self, change: Callable[[], None]) -> None:
        """Change the page from within a job, and wait until that is done."""
        shown = threading.Event()

        def tick() -> None:
            try:
                if not self._ended:
                    change()
            except MatcamError as error:
                self._complain(str(error))
            except Exception:
                traceback.print_exc()
                self._complain("this is a fault of matcam, not of your input; the terminal shows where")
            finally:
                shown.set()

        if not self._ended:
            try:
                self._document.add_next_tick_callback(tick)
            except AttributeError:  # the document has been destroyed in this instant: its parts are gone
                self._ended = True
                return
            shown.wait(_SHOWN_WITHIN)

    def _run(self) -> None:
        while True:
            with self._wake:
                while not self._ended and (self._job is None or self._due > time.monotonic()):
                    self._wake.wait(None if self._job is None else self._due - time.monotonic())
                if self._ended or self._job is None:
                    return
                (work, show), self._job, self.busy = self._job, None, True
            self._do(work, show)
            self.busy = False

    def _do(self, work: Callable[[], Any], show: Callable[[Any], None]) -> None:
        try:
            result = work()
        except MatcamError as error:
            message = str(error)
            self.show(lambda: self._complain(message))
        except MemoryError:
            self.show(lambda: self._complain("not enough memory"))
        except Exception:
            if not self._ended:
                traceback.print_exc()
                self.show(
                    lambda: self._complain("this is a fault of matcam, not of your input; the terminal shows where")
                )
        else:
            self.show(lambda: show(result))
