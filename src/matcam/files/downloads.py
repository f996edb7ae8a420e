"""Downloads of published measurements, checked against their published checksums."""

from __future__ import annotations

import hashlib
import io
import os
import re
import struct
import time
import zipfile
import zlib
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from matcam.core.errors import DownloadError, one_line, unknown_name
from matcam.core.io import reading, replacing
from matcam.core.readers.names import is_file

MERL_SOURCE = "https://zenodo.org/records/8101681/files/BRDFDatabase.zip"
"""Address of the MERL BRDF database as published by its owners (CC BY-SA 4.0, doi:10.5281/zenodo.8101680): one archive,
from which single materials are read by HTTP range requests.
"""

SOURCE_SETTING = "MATCAM_MERL_SOURCE"
"""Environment variable that names another source: an archive (ending in .zip) or a folder of NAME.binary files."""

_SIZE = 34_992_012  # bytes of every MERL file
_TIMEOUT = 60  # longest time without data, s
_DEADLINE = 1800.0  # longest time for one file, s: 20 kB/s suffice
_BLOCK = 1 << 16  # largest piece of a file in memory, bytes


@cache
def merl_checksums() -> dict[str, str]:
    lines = resources.files("matcam").joinpath("data/merl_sha256.txt").read_text(encoding="ascii").splitlines()
    return {name.removesuffix(".binary"): sha256 for sha256, _, name in (line.split() for line in lines)}


def fetch_merl(
    material: str,
    folder: str | Path,
    source: str | None = None,
    progress: Callable[[int, int], None] | None = None,
    *,
    force: bool = False,
) -> Path:
    """Fetch one published MERL file and check it.

    An existing correct file is kept. No new file remains after an error. The download stops if the file is larger than
    the published one.

    Args:
        material: name as published, such as "chrome".
        folder: folder for NAME.binary.
        source: address of an archive (ending in .zip) or of a folder on another server. Default: None, the value of the
            environment variable MATCAM_MERL_SOURCE if it is set, otherwise `MERL_SOURCE`.
        progress: function that is called with (done, total) bytes. Default: None.
        force: True to replace an existing file that differs from the published one. Default: False.

    Returns:
        Path of the file.

    Raises:
        ArgumentError: the material is unknown; the message suggests the nearest name.
        DownloadError: the file cannot be fetched, or its SHA-256 differs from the published one.
        OutputError: a different file of this name exists and `force` is False, or the file cannot be written.
    """
    checksums = merl_checksums()
    if material not in checksums:
        raise unknown_name("MERL material", material, checksums)
    path = Path(folder) / f"{material}.binary"
    if is_file(path) and _sha256(path) == checksums[material]:
        return path
    source = source or os.environ.get(SOURCE_SETTING) or MERL_SOURCE
    with replacing(path, force=force) as temporary, temporary.open("wb") as output:
        digest, done = hashlib.sha256(), 0
        with closing(_pieces(source, material)) as pieces:
            for piece in pieces:
                digest.update(piece)
                output.write(piece)
                done += len(piece)
                if progress:
                    progress(done, _SIZE)
        if digest.hexdigest() != checksums[material]:
            raise DownloadError(
                f"{material}: the file from {source} is not the published one (SHA-256 differs): use another source"
            )
    return path


def _sha256(path: Path) -> str:
    with reading(path), path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _pieces(source: str, material: str) -> Generator[bytes]:
    """Yield a published file in pieces, up to its published size. All failures raise DownloadError."""
    # imported here, because the import is slow and only a download requires it
    import requests
    import urllib3

    try:
        with requests.Session() as session:
            web = _Web(session, time.monotonic() + _DEADLINE)
            if source.endswith(".zip"):
                yield from _member(web, source, f"{material}.binary")
            else:
                yield from _limited(web.stream(f"{source.rstrip('/')}/{material}.binary"), source)
    except DownloadError as error:
        raise DownloadError(f"{material}: {error}") from None
    except zipfile.BadZipFile:
        raise DownloadError(f"{material}: {source} is not a zip archive, or is damaged: use another source") from None
    except (requests.RequestException, urllib3.exceptions.HTTPError) as error:
        why = one_line(error)
        if isinstance(error, requests.exceptions.InvalidSchema | requests.exceptions.MissingSchema):
            why = "an address must begin with https:// or http://"
        elif isinstance(error, requests.ConnectionError):  # its text describes objects of the library
            why = "there is no connection to the server"
        raise DownloadError(
            f"{material}: the file cannot be fetched from {source}: {why}; check the address and the connection"
        ) from None
    except (EOFError, zlib.error, ValueError, OverflowError, struct.error, NotImplementedError, RuntimeError) as error:
        raise DownloadError(
            f"{material}: the file cannot be fetched from {source}, because the data are damaged ({one_line(error)}): use "
            "another source"
        ) from None


def _limited(pieces: Iterable[bytes], source: str) -> Iterator[bytes]:
    done = 0
    for piece in pieces:
        done += len(piece)
        if done > _SIZE:
            raise DownloadError(
                f"{source}: the server sends more than the {_SIZE} bytes of the published file: use another source"
            )
        yield piece
    if done < _SIZE:
        raise DownloadError(f"{source}: the data end after {done} of {_SIZE} bytes: try again")


def _member(web: _Web, source: str, name: str) -> Iterator[bytes]:
    remote = _RemoteFile(web, source)
    with zipfile.ZipFile(remote) as archive:
        member = next((m for m in archive.infolist() if m.filename.rsplit("/", 1)[-1] == name), None)
        if member is None:
            raise DownloadError(f"{source} does not contain {name}: use another source")
        if member.file_size != _SIZE:
            raise DownloadError(
                f"{source}: the archive lists {name} with {member.file_size} bytes, but the published file has {_SIZE}: use "
                "another source"
            )
        remote.end = min(remote.size, member.header_offset + member.compress_size + _BLOCK)
        with archive.open(member) as packed:
            yield from _limited(iter(lambda: packed.read(_BLOCK), b""), source)


class _Web:
    """HTTP requests with a deadline, limited to the requested bytes."""

    def __init__(self, session: Any, deadline: float):
        self.session, self.deadline = session, deadline

    def stream(self, address: str, span: tuple[int, int] | None = None) -> Iterator[bytes]:
        """Yield the response of a server in pieces.

        `span` contains the first and the last byte of a range. Default: None, the whole file.
        """
        headers = {"Accept-Encoding": "identity"} | ({"Range": f"bytes={span[0]}-{span[1]}"} if span else {})
        with self.session.get(address, headers=headers, timeout=_TIMEOUT, stream=True) as reply:
            reply.raise_for_status()
            if span:
                self._check_span(address, reply, span)
            left = span[1] - span[0] + 1 if span else _SIZE + 1
            read = getattr(
                reply.raw, "read1", reply.raw.read
            )  # pieces as received, so that the deadline also applies to a slow server
            while left > 0 and (piece := read(min(_BLOCK, left))):
                left -= len(piece)
                yield piece
                if time.monotonic() > self.deadline:
                    raise DownloadError(f"{address}: the download is not finished after {_DEADLINE:g} s: try again")

    @staticmethod
    def _check_span(address: str, reply: Any, span: tuple[int, int]) -> None:
        """Check that the response is a range of bytes that starts at the requested byte."""
        if reply.status_code != 206:
            raise DownloadError(
                f"{address}: the server sends only the whole archive: download and unpack the archive, or give the "
                "address of a folder with the unpacked files as source"
            )
        stated = reply.headers.get("Content-Range", "")
        if not re.fullmatch(rf"bytes {span[0]}-[0-9]{{1,18}}/[0-9]{{1,18}}", stated):
            raise DownloadError(
                f"{address}: the server answered a request for a range of bytes with {stated!r:.60}: use another source"
            )

    def size(self, address: str) -> int:
        """Request the size of a file, bytes.

        The request is for one byte, because some servers respond differently to HEAD.
        """
        headers = {"Accept-Encoding": "identity", "Range": "bytes=0-0"}
        with self.session.get(address, headers=headers, timeout=_TIMEOUT, stream=True) as reply:
            reply.raise_for_status()
            self._check_span(address, reply, (0, 0))
            return int(reply.headers["Content-Range"].rpartition("/")[2])


class _RemoteFile(io.RawIOBase):
    """Read-only file on a server, with the methods that zipfile requires.

    The last 128 KiB of the file are in memory. The remainder is streamed sequentially.

    Attributes:
        size: size of the file, bytes.
        end: index of the first byte after a stream, unless the stream starts with a longer read.
    """

    def __init__(self, web: _Web, address: str):
        self.web, self.address, self.size = web, address, web.size(address)
        self.end, self._at, self._stream_at = self.size, 0, -1
        self._stream: Iterator[bytes] = iter(())
        self._waiting = b""
        # the last 128 KiB of an archive contain its directory
        self._tail_at = max(0, self.size - (1 << 17))
        self._tail = b"".join(web.stream(address, (self._tail_at, self.size - 1))) if self.size else b""

    def seekable(self) -> bool:
        return True

    def readable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._at

    def seek(self, offset: int, whence: int = 0) -> int:
        self._at = max(0, offset + (0, self._at, self.size)[whence])
        return self._at

    def read(self, size: int = -1) -> bytes:
        size = max(0, self.size - self._at) if size < 0 else size
        # a directory of more than 16 MiB indicates damage
        if size > (16 << 20):
            raise DownloadError(
                f"{self.address}: the list of members has {size} bytes: the archive is damaged; use another source"
            )
        position = self._at - self._tail_at
        found = self._tail[position:][:size] if position >= 0 else self._streamed(size)
        self._at += len(found)
        return found

    def _streamed(self, size: int) -> bytes:
        if self._stream_at != self._at:
            self._stream = self.web.stream(self.address, (self._at, max(self.end, self._at + size) - 1))
            self._stream_at, self._waiting = self._at, b""
        while len(self._waiting) < size and (piece := next(self._stream, b"")):
            self._waiting += piece
        found, self._waiting = self._waiting[:size], self._waiting[size:]
        self._stream_at += len(found)
        return found
