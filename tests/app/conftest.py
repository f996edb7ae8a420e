"""The app in a process of its own, as its users start it."""

import contextlib
import os
import signal
import subprocess
import sys
import threading

import pytest

from tests.conftest import REPOSITORY

pytest.importorskip("bokeh", reason="the extra matcam[app] is not installed")

CHROMIUM = "/usr/bin/chromium"


class App:
    """A running `matcam app`."""

    def __init__(self, *arguments):
        environment = os.environ | {"PYTHONPATH": str(REPOSITORY / "src"), "PYTHONUNBUFFERED": "1"}
        command = [sys.executable, "-m", "matcam", "app", "--no-browser", *map(str, arguments)]
        self.process = subprocess.Popen(
            command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.errors = []
        self._reader = threading.Thread(target=lambda: self.errors.extend(self.process.stderr), daemon=True)
        self._reader.start()
        self.url = self.process.stdout.readline().strip()
        assert self.url.startswith("http://127.0.0.1:"), self.errors
        self.port = int(self.url.split(":")[2].split("/")[0])
        self.token = self.url.split("token=")[1]

    def end(self, number=signal.SIGINT):
        """Interrupt it; return its exit code."""
        self.process.send_signal(number)
        try:
            return self.process.wait(20)
        finally:
            self.process.kill()
            self._reader.join(5)
            self.process.stdout.close()
            self.process.stderr.close()


@contextlib.contextmanager
def running(*arguments):
    app = App(*arguments)
    try:
        yield app
    finally:
        if app.process.poll() is None:
            app.end()


@pytest.fixture(scope="module")
def app():
    with running() as one:
        yield one
