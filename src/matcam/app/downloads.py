"""What a page offers to save: bytes in memory under an address that cannot be guessed, each replaced by its successor."""

from __future__ import annotations

import secrets
from html import escape
from typing import Any
from urllib.parse import quote

from tornado.web import RequestHandler

_KEPT = 64
"""Files that are offered at once, over all pages."""


class Downloads:
    """Hold the files that pages offer."""

    def __init__(self) -> None:
        self._files: dict[str, tuple[str, bytes]] = {}

    def offer(self, name: str, content: bytes, words: str = "") -> str:
        """Return a link, as HTML, that saves `content` as `name`."""
        key = secrets.token_urlsafe(16)
        self._files[key] = (name, content)
        while len(self._files) > _KEPT:
            del self._files[next(iter(self._files))]
        return f'<a href="/save/{key}" download="{escape(name, quote=True)}">{escape(words or name)}</a>'

    def get(self, key: str) -> tuple[str, bytes] | None:
        """Return name and content of a file; None where there is none."""
        return self._files.get(key)

    def close(self) -> None:
        """Forget all files."""
        self._files.clear()

    def pattern(self) -> Any:
        """Return the server's rule for the links."""
        return r"/save/([\w-]+)", _Saved, {"downloads": self}


class _Saved(RequestHandler):
    def initialize(self, downloads: Downloads) -> None:
        self.downloads = downloads

    def get(self, key: str) -> None:
        file = self.downloads.get(key)
        if file is None:
            self.set_status(404)
            self.finish("this file is no longer offered: ask for it again in the page\n")
            return
        name, content = file
        self.set_header("Content-Type", "application/octet-stream")
        self.set_header("Content-Disposition", f"attachment; filename*=UTF-8''{quote(name, safe='')}")
        self.finish(content)
