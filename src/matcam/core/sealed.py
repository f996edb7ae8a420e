"""Files of a cache that are believed only whole: each ends in a SHA-256 of what it belongs to and of its content.

What is damaged, or another's, is removed and made again; one line is logged. A file that cannot be written is not: a full disk
must not stop any work. The seal finds damage; it does not find a forger. Against forgers, only what this user or the system's
own has written is read, where nobody else may change it.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import stat
import threading
from collections.abc import Iterator
from pathlib import Path

from matcam.core.errors import OutputError
from matcam.core.io import one_by_one, replacing

_SEAL = hashlib.sha256().digest_size
_log = logging.getLogger("matcam")


def read_sealed(path: Path, key: bytes) -> bytes | None:
    """Return the content that was written under this key; None where it is not there, or is damaged."""
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):  # a pipe would have no end
            return None
        if _is_foreign(status):
            _log.warning(
                "matcam: %s in the cache is another user's, or anybody may change it: it is not used", path.name
            )
            return None
        whole = path.read_bytes()
    except OSError:
        return None
    content, seal = whole[:-_SEAL], whole[-_SEAL:]
    if len(whole) < _SEAL or _seal(key, content) != seal:
        _log.warning("matcam: %s in the cache is damaged: it is made again", path.name)
        with contextlib.suppress(OSError):
            path.unlink()
        return None
    return content


def write_sealed(path: Path, key: bytes, content: bytes) -> None:
    """Write content under a key, whole or not at all."""
    with contextlib.suppress(OutputError), one_by_one(), replacing(path, force=True) as temporary:
        temporary.write_bytes(content + _seal(key, content))


def _is_foreign(status: os.stat_result) -> bool:
    """Tell whether somebody else could have written a file."""
    if not hasattr(os, "getuid"):
        return False
    return status.st_uid not in (os.getuid(), 0) or bool(status.st_mode & stat.S_IWOTH)


def _seal(key: bytes, content: bytes) -> bytes:
    digest = hashlib.sha256(len(key).to_bytes(8, "little") + key)
    digest.update(content)
    return digest.digest()


class CompiledFunctions:
    """Keep JAX's compiled functions on disk, in place of its own cache, which believes what it finds.

    Args:
        path: folder of the files.
    """

    _passed_by = threading.local()

    def __init__(self, path: str):
        self._path = Path(path)  # the name by which JAX asks for it

    @classmethod
    @contextlib.contextmanager
    def passed_by(cls) -> Iterator[None]:
        """Have this thread compile anew what it compiles, and not keep it here."""
        cls._passed_by.now = True
        try:
            yield
        finally:
            cls._passed_by.now = False

    def get(self, key: str) -> bytes | None:
        """Return what was kept under a key, or None."""
        return None if self._is_passed_by else read_sealed(self._file(key), key.encode())

    def put(self, key: str, value: bytes) -> None:
        """Keep bytes under a key."""
        if not self._is_passed_by:
            write_sealed(self._file(key), key.encode(), value)

    @property
    def _is_passed_by(self) -> bool:
        return getattr(self._passed_by, "now", False)

    def _file(self, key: str) -> Path:
        return self._path / f"{hashlib.sha256(key.encode()).hexdigest()[:40]}.xla"
