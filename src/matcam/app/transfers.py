"""Uploads and downloads of the page.

Dropped files are stored in a folder of the session. The folder is removed at the end of the session. Files that the page
offers to save are in memory, under addresses that cannot be guessed.
"""

from __future__ import annotations

import base64
import binascii
import re
import secrets
import shutil
import tempfile
from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import quote

from bokeh.models.widgets import FileInput
from tornado.web import RequestHandler


class Downloads:
    """Registry of the files that pages offer to save."""

    def __init__(self) -> None:
        self._files: dict[str, tuple[str, bytes]] = {}

    def offer(self, name: str, content: bytes) -> str:
        key = secrets.token_urlsafe(16)
        self._files[key] = (name, content)
        # all pages together offer at most 64 files, which limits the memory of the app
        while len(self._files) > 64:
            del self._files[next(iter(self._files))]
        return f'<a href="/save/{key}" download="{escape(name, quote=True)}">{escape(name)}</a>'

    def get(self, key: str) -> tuple[str, bytes] | None:
        return self._files.get(key)

    def close(self) -> None:
        self._files.clear()

    def pattern(self) -> Any:
        return r"/save/([\w-]+)", _Saved, {"downloads": self}


class _Saved(RequestHandler):
    def initialize(self, downloads: Downloads) -> None:
        self.downloads = downloads

    def get(self, key: str) -> None:
        file = self.downloads.get(key)
        if file is None:
            self.set_status(404)
            self.finish("this file is no longer offered: save it again in the page\n")
            return
        name, content = file
        self.set_header("Content-Type", "application/octet-stream")
        self.set_header("Content-Disposition", f"attachment; filename*=UTF-8''{quote(name, safe='')}")
        self.finish(content)


_FOLDER = "matcam-app-"
"""Start of the name of the temporary folder of dropped files."""
LARGEST = 40 << 20
"""Largest size of a file that can be dropped, bytes. Larger files are given on the command line, and are not copied."""


class Upload:
    """Field for dropping a file or choosing it with the keyboard.

    Args:
        title: label.
        dropped: called with the path of the stored file.
        complain: function that shows a message of one line.
        name: name of the field in the page. Default: "upload".
    """

    def __init__(
        self, title: str, dropped: Callable[[Path], None], complain: Callable[[str], None], name: str = "upload"
    ):
        self._dropped, self._complain = dropped, complain
        self._folder: Path | None = None
        self._count = 0
        self.layout = FileInput(title=title, name=name)
        self.layout.on_change("value", self._arrived)

    def close(self) -> None:
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)

    def _arrived(self, attribute: str, old: Any, value: Any) -> None:
        # the message of the content also sets the name, but later
        document = self.layout.document
        if value and document is not None:
            document.add_next_tick_callback(self._take)

    def _take(self) -> None:
        value = self.layout.value
        name, value = str(self.layout.filename or "file"), str(value or "")
        if not value:
            return
        if len(value) > LARGEST * 4 // 3 + 8:
            self._complain(f"{name}: the file is larger than {LARGEST >> 20} MB: open it with `matcam app FILE`")
            return
        try:
            content = base64.b64decode(value, validate=True)
        except (binascii.Error, ValueError):
            self._complain(f"{name}: the file did not arrive completely: drop it again")
            return
        if self._folder is None:
            self._folder = Path(tempfile.mkdtemp(prefix=_FOLDER))
        self._count += 1
        folder = self._folder / str(self._count)
        folder.mkdir()
        path = folder / safe_name(name)
        path.write_bytes(content)
        self._complain("")
        self._dropped(path)


def worded(text: str) -> str:
    """Adapt a message to the page: without the folders of dropped files, and without options of the command line."""
    return re.sub(rf"\S*{_FOLDER}\w+[\\/]\d+[\\/]", "", text).replace(" (--tone)", "")


def safe_name(name: str) -> str:
    last = re.split(r"[\\/]", name)[-1]
    plain = re.sub(r"[^\w.() -]", "_", last).strip(" .")[-120:]
    return plain or "file"
