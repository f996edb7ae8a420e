"""Server of the app: one page, behind an access control.

The server reads only files from the user of the app, and sends no requests to other servers.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import signal
import threading
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.document import Document
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.settings import settings
from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop
from tornado.netutil import bind_sockets

from matcam.app.guard import Guard
from matcam.app.page import Page
from matcam.app.transfers import Downloads
from matcam.app.worker import THREAD
from matcam.core.errors import ArgumentError

_IDLE = 60.0
"""Time until an idle connection, or one with an incomplete request, is closed, s."""


class AppServer:
    """Server of the page of the app.

    Args:
        files: files and folders that the user opened.
        host: address to listen on. Default: "127.0.0.1", only this machine.
        port: port to listen on. Default: 0, any free port.

    Raises:
        ArgumentError: the server cannot listen on the address.
    """

    def __init__(self, files: Sequence[Path] = (), host: str = "127.0.0.1", port: int = 0):
        _quiet()
        settings.resources = "server"  # independent of environment variables
        settings.log_level = "error"
        try:
            sockets = bind_sockets(port, host)
        except (OSError, UnicodeError) as error:
            raise ArgumentError(
                f"cannot listen on host {host!r} and port {port}: {getattr(error, 'strerror', None) or error}; choose another "
                "host or port"
            ) from None
        self.port = int(sockets[0].getsockname()[1])
        self.downloads = Downloads()
        self.pages: set[Page] = set()
        # the largest message exceeds the text of the largest file that can be dropped on the page
        tornado = _Site(
            Application(FunctionHandler(self._page(tuple(files)))),
            extra_websocket_origins=["*"],  # the access control has checked the origin
            extra_patterns=[self.downloads.pattern()],
            websocket_max_message_size_bytes=64 << 20,
            websocket_compression_level=None,
            check_unused_sessions_milliseconds=2000,
            unused_session_lifetime_milliseconds=4000,
            keep_alive_milliseconds=20_000,
            stats_log_frequency_milliseconds=10**9,
        )
        self.guard = Guard(tornado, host, self.port)
        http = HTTPServer(self.guard, idle_connection_timeout=_IDLE, body_timeout=_IDLE)
        http.add_sockets(sockets)
        self._server = BaseServer(IOLoop.current(), tornado, http)
        self._server.start()

    @property
    def address(self) -> str:
        return self.guard.address

    @property
    def busy(self) -> bool:
        return any(thread.name == THREAD for thread in threading.enumerate())

    def run(self) -> None:
        """Serve until a signal interrupts the process, and then call the previous handler of this signal."""
        loop = asyncio.get_event_loop()
        interrupted: list[Callable[[], Any]] = []

        def catch(number: int, handler: Callable[..., Any]) -> None:
            # raised in the loop, because an interruption could be lost in a callback of a library
            def end() -> None:
                interrupted.append(lambda: handler(number, None))
                loop.stop()

            with contextlib.suppress(NotImplementedError):  # Windows
                loop.add_signal_handler(number, end)

        caught = {}
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)
            handler = None if number is None else signal.getsignal(number)
            if number is not None and callable(handler):
                caught[number] = handler
                catch(number, handler)
        try:
            IOLoop.current().start()
        finally:
            for number, handler in caught.items():
                with contextlib.suppress(NotImplementedError):
                    loop.remove_signal_handler(number)
                signal.signal(number, handler)
            self.stop()
        for act in interrupted:
            act()

    def stop(self) -> None:
        for page in list(self.pages):
            page.close()
        self.downloads.close()
        self._server.unlisten()
        self._server.stop(wait=False)

    def _page(self, files: tuple[Path, ...]) -> Callable[[Document], None]:
        def make(document: Document) -> None:
            try:
                page = Page(document, files, self.downloads)
            except Exception:
                traceback.print_exc()
                raise
            self.pages.add(page)

            def ended(context: Any) -> None:
                self.pages.discard(page)
                page.close()

            document.on_session_destroyed(ended)

        return make


class _Site(BokehTornado):
    """Server of Bokeh that delivers only the required scripts."""

    def resources(self, absolute_url: str | bool | None = None) -> Any:
        return super().resources(absolute_url).clone(components=["bokeh", "bokeh-widgets"])


def _quiet() -> None:
    """Silence the logs of the server libraries, because errors of a page are shown in the page."""
    for name in ("bokeh", "tornado.access", "tornado.general", "tornado.application"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
