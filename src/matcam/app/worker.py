"""Background work of the page: the newest request replaces older requests that have not started.

A thread computes, so that the server can read messages of the browser, such as new values of a slider, at the same time. A
result is shown before the next request starts, so that neither requests nor results queue up. A computation starts after a
few milliseconds, so that it uses the last of several values that arrive in this time.
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

DRAINED = {"after": 0.004, "within": 0.05}
"""Times, s, within which waiting moves of a slider replace each other (see `Newest.ask`)."""

THREAD = "matcam-app"
"""Name of the threads that compute."""


class Newest:
    """Queue that contains only the newest requested job.

    Args:
        document: the page's document; results are shown under its lock.
        complain: function that shows a message of one line about a failed job.
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
        """Request a job, which replaces a job that has not started.

        Args:
            work: function that does the job.
            show: function that shows the result in the page.
            after: delay before the job starts, s; another request restarts the delay. Default: 0.
            within: longest delay after the first request, s, even if other requests follow. Default: infinite.
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
            if not waits:  # a thread with an earlier deadline then finds this job
                self._wake.notify()

    def overtaken(self) -> bool:
        """Check whether a long job can stop early, because another job waits or the queue is closed."""
        return self._ended or self._job is not None

    def close(self) -> None:
        """Stop accepting work, and discard the result of the running job."""
        with self._wake:
            self._ended, self._job = True, None
            self._wake.notify()

    def show(self, change: Callable[[], None]) -> None:
        """Change the page from within a job, and wait at most 5 s for the change."""
        shown = threading.Event()

        def tick() -> None:
            try:
                if not self._ended:
                    change()
            except Exception as error:
                self._complain(_explained(error))
            finally:
                shown.set()

        if not self._ended:
            try:
                self._document.add_next_tick_callback(tick)
            except AttributeError:  # the document has been destroyed in the meantime
                self._ended = True
                return
            # wait for at most 5 s, because a closed page shows no results
            shown.wait(5.0)

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
        except Exception as error:
            if not self._ended:
                message = _explained(error)
                self.show(lambda: self._complain(message))
        else:
            self.show(lambda: show(result))


def _explained(error: Exception) -> str:
    if isinstance(error, MatcamError):
        return str(error)
    if isinstance(error, MemoryError):
        return "not enough memory: open smaller files, or close other programs"
    traceback.print_exception(error)
    return "this is a fault of matcam, not of your input; the terminal shows the traceback"
