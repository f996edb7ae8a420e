"""Cache of files that end in a seal, a SHA-256 hash of the key and the content of the file.

A file that is damaged, or that belongs to another key, is removed. One line is logged, and the content is computed
again. A file that cannot be written is skipped, because a full disk must not stop any work.

The seal detects damage, not forgery. To prevent forgery, a folder or a file is used only if it belongs to this user or
to the system, and no other user may change it. A folder is opened once and checked. Its files are accessed through the
open folder, so that the folder cannot be replaced between check and use. Links are not followed. Systems without such
access to files, such as Windows, use paths without these checks.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import stat
import threading
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

_SEAL = hashlib.sha256().digest_size
_READ = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
_BY_FOLDER = {os.open, os.rename, os.unlink, os.stat} <= os.supports_dir_fd and hasattr(os, "O_DIRECTORY")
_log = logging.getLogger("matcam")


def read_sealed(path: Path, key: bytes) -> memoryview | None:
    """Read the content that is stored under a key, without copying it in memory.

    The result is None if the file is missing, damaged, or not protected from other users.
    """
    try:
        with _opened(path.parent) as folder:
            whole = _read_own(folder, path)
            if whole is None:
                return None
            content, seal = memoryview(whole)[:-_SEAL], whole[-_SEAL:]
            if len(whole) >= _SEAL and _seal(key, content) == seal:
                return content
            _log.warning("matcam: %s in the cache is damaged: it is computed again", path.name)
            folder.unlink(path.name)
    except OSError:
        pass
    return None


def write_sealed(path: Path, key: bytes, content: bytes | memoryview) -> None:
    """Write the content of a key atomically, to a file that only this user can read.

    A file that cannot be written is skipped.
    """
    temporary = f".{path.stem}-{os.urandom(4).hex()}{path.suffix}"
    with contextlib.suppress(OSError):
        _make(path.parent)
        with _opened(path.parent) as folder:
            try:
                with os.fdopen(folder.open(temporary, _NEW), "wb") as file:
                    file.writelines((content, _seal(key, content)))
                folder.rename(temporary, path.name)
            except BaseException:
                with contextlib.suppress(OSError):
                    folder.unlink(temporary)
                raise


def sealed_files(path: Path) -> dict[str, os.stat_result]:
    """List the files of a cache folder: size and times by name. The result is empty if the folder cannot be used."""
    try:
        with _opened(path) as folder:
            found = {name: folder.stat(name) for name in folder.names()}
    except OSError:
        return {}
    return {name: status for name, status in found.items() if stat.S_ISREG(status.st_mode)}


def remove_sealed(path: Path, names: Iterable[str]) -> None:
    with contextlib.suppress(OSError), _opened(path) as folder:
        for name in names:
            with contextlib.suppress(OSError):
                folder.unlink(name)


class _Folder(NamedTuple):
    """Open folder of a cache.

    `number` is the file descriptor of the folder. It is None on systems that access files only by path. On such
    systems the folder is not checked.
    """

    number: int | None
    path: Path

    def _of(self, name: str) -> str | Path:
        return name if self.number is not None else self.path / name

    def open(self, name: str, flags: int) -> int:
        # non-blocking: a pipe may have no writer
        return os.open(self._of(name), flags | getattr(os, "O_NONBLOCK", 0), 0o600, dir_fd=self.number)

    def rename(self, old: str, new: str) -> None:
        os.replace(self._of(old), self._of(new), src_dir_fd=self.number, dst_dir_fd=self.number)

    def unlink(self, name: str) -> None:
        os.unlink(self._of(name), dir_fd=self.number)

    def stat(self, name: str) -> os.stat_result:
        return os.stat(self._of(name), dir_fd=self.number, follow_symlinks=False)

    def names(self) -> list[str]:
        return os.listdir(self.path if self.number is None else self.number)  # noqa: PTH208


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[_Folder]:
    """Open a folder that no other user may change.

    An OSError is raised if the folder is missing, or if another user may change it.
    """
    if not _BY_FOLDER:
        yield _Folder(None, path)
        return
    number = os.open(path, _READ | os.O_DIRECTORY)
    try:
        parent = os.stat(
            "..", dir_fd=number
        )  # others may rename a folder in a world-writable folder without sticky bit
        open_to_all = parent.st_mode & stat.S_IWOTH and not parent.st_mode & stat.S_ISVTX
        if _is_foreign(os.fstat(number)) or parent.st_uid not in (os.getuid(), 0) or open_to_all:
            _warn_of(path)
            raise PermissionError(path)
        yield _Folder(number, path)
    finally:
        os.close(number)


def _read_own(folder: _Folder, path: Path) -> bytes | None:
    """Read a file that belongs to this user or to the system, and that no other user may change.

    The result is None for any other file.
    """
    with os.fdopen(folder.open(path.name, _READ), "rb") as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode):
            return None
        if _is_foreign(status):
            _warn_of(path.parent)
            return None
        return file.read()


def _make(path: Path) -> None:
    for folder in (*reversed(path.parents), path):
        if not folder.exists():
            folder.mkdir(mode=0o700, exist_ok=True)


@cache
def _warn_of(folder: Path) -> None:
    _log.warning(
        "matcam: the cache %s is not used, because another user owns it or one of its files, or may change them: "
        "remove the folder, or run chmod -R go-w on it", folder
    )  # fmt: skip


def _is_foreign(status: os.stat_result) -> bool:
    return hasattr(os, "getuid") and (
        status.st_uid not in (os.getuid(), 0) or bool(status.st_mode & (stat.S_IWGRP | stat.S_IWOTH))
    )


def _seal(key: bytes, content: bytes | memoryview) -> bytes:
    digest = hashlib.sha256(len(key).to_bytes(8, "little") + key)
    digest.update(content)
    return digest.digest()


class CompiledFunctions:
    """Cache of JAX's compiled functions on disk.

    It replaces the cache of JAX, which does not detect damage.

    Args:
        path: folder of the files.
    """

    _passed_by = threading.local()

    def __init__(self, path: str):
        self._path = Path(path)  # name of the attribute in JAX

    @classmethod
    @contextlib.contextmanager
    def passed_by(cls) -> Iterator[None]:
        """Compile without this cache in the current thread, during the block."""
        cls._passed_by.now = True
        try:
            yield
        finally:
            cls._passed_by.now = False

    def get(self, key: str) -> bytes | None:
        stored = None if self._is_passed_by else read_sealed(self._file(key), key.encode())
        return None if stored is None else bytes(stored)

    def put(self, key: str, value: bytes) -> None:
        if not self._is_passed_by:
            write_sealed(self._file(key), key.encode(), value)

    @property
    def _is_passed_by(self) -> bool:
        return getattr(self._passed_by, "now", False)

    def _file(self, key: str) -> Path:
        return self._path / f"{hashlib.sha256(key.encode()).hexdigest()[:40]}.xla"
