"""Files that are dropped on the page: kept in a folder of this session alone, and removed with it."""

from __future__ import annotations

import base64
import binascii
import re
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bokeh.models.widgets import FileInput

from matcam.app.controls import WIDTH

LARGEST = 40 << 20
"""Largest file that can be dropped, bytes; a larger one is opened by its name on the command line."""


class Upload:
    """A field on which a file can be dropped, or chosen with the keyboard.

    Args:
        title: what to drop.
        dropped: called with the path of a file.
        complain: shows one line.
    """

    def __init__(
        self, title: str, dropped: Callable[[Path], None], complain: Callable[[str], None], name: str = "upload"
    ):
        self._dropped, self._complain = dropped, complain
        self._folder: Path | None = None
        self._count = 0
        self.layout = FileInput(title=title, width=WIDTH - 16, margin=(2, 8, 2, 8), name=name)
        self.layout.on_change("value", self._arrived)

    def close(self) -> None:
        """Remove the files."""
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)

    def _arrived(self, attribute: str, old: Any, value: Any) -> None:
        # the name is changed by the same message, behind the content
        document = self.layout.document
        if value and document is not None:
            document.add_next_tick_callback(self._take)

    def _take(self) -> None:
        value = self.layout.value
        name, value = str(self.layout.filename or "file"), str(value or "")
        if not value:
            return
        if len(value) > LARGEST * 4 // 3 + 8:
            self._complain(f"{name}: larger than {LARGEST >> 20} MB: open it with `matcam app FILE`")
            return
        try:
            content = base64.b64decode(value, validate=True)
        except (binascii.Error, ValueError):
            self._complain(f"{name}: did not arrive whole: drop it again")
            return
        if self._folder is None:
            self._folder = Path(tempfile.mkdtemp(prefix="matcam-app-"))
        self._count += 1
        folder = self._folder / str(self._count)
        folder.mkdir()
        path = folder / safe_name(name)
        path.write_bytes(content)
        self._complain("")
        self._dropped(path)


def safe_name(name: str) -> str:
    """Return a file's name without its folder, and without what a system could mistake for anything but a name."""
    last = re.split(r"[\\/]", name)[-1]
    plain = re.sub(r"[^\w.() -]", "_", last).strip(" .")[-120:]
    return plain or "file"
