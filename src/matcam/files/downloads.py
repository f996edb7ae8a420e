"""Fetching published measurements, and making sure that what comes is what was published."""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Callable
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from matcam.core.errors import DownloadError, unknown_name

MERL_SOURCE = "https://zenodo.org/records/8101681/files/BRDFDatabase.zip"
"""The MERL BRDF database as its owners publish it since 2023 (CC BY-SA 4.0, doi:10.5281/zenodo.8101680): one archive,
out of which single materials are read by HTTP range requests."""

SOURCE_SETTING = "MATCAM_MERL_SOURCE"
"""Environment variable that names another source: an archive (ending in .zip) or a folder of NAME.binary files."""

_TIMEOUT = 60  # s
_READ_AHEAD = 1 << 20  # bytes per range request


@cache
def merl_checksums() -> dict[str, str]:
    """SHA-256 of the 100 published MERL files, by material."""
    lines = resources.files("matcam").joinpath("data/merl_sha256.txt").read_text(encoding="ascii").splitlines()
    return {name.removesuffix(".binary"): sha256 for sha256, _, name in (line.split() for line in lines)}


def fetch_merl(
    material: str, folder: str | Path, source: str | None = None, progress: Callable[[int, int], None] | None = None
) -> Path:
    """Fetch one true MERL file into `folder` and return its path; a file that is there and is right is kept.

    source: an archive or folder of another server; default `SOURCE_SETTING`, else `MERL_SOURCE`. progress(done, total)
    is called with bytes. Raises ArgumentError for an unknown material and DownloadError where the file cannot be had or
    is not, by its SHA-256, the published one; nothing is left under the final name then.
    """
    # pooch brings requests along: half a second that only a download should cost
    import pooch
    import requests

    checksums = merl_checksums()
    if material not in checksums:
        raise unknown_name("MERL material", material, checksums)
    source = source or os.environ.get(SOURCE_SETTING) or MERL_SOURCE
    pooch.get_logger().setLevel("ERROR")  # it would talk beside our progress
    downloader: Any
    if source.endswith(".zip"):
        url, downloader = f"{source}#{material}.binary", _ArchiveMember(source, f"{material}.binary", progress)
    else:
        url, downloader = f"{source.rstrip('/')}/{material}.binary", _WholeFile(progress)
    try:
        path = pooch.retrieve(
            url,
            known_hash=f"sha256:{checksums[material]}",
            fname=f"{material}.binary",
            path=folder,
            downloader=downloader,
        )
    except requests.exceptions.RequestException as error:
        raise DownloadError(f"{material}: cannot be fetched from {source}: {_one_line(error)}") from None
    except zipfile.BadZipFile:
        raise DownloadError(f"{material}: {source} is not a zip archive") from None
    except ValueError as error:
        if "hash" not in str(error):
            raise
        raise DownloadError(f"{material}: what {source} sent is not the published file (SHA-256 differs)") from None
    except OSError as error:
        raise DownloadError(f"{material}: cannot be written to {folder}: {error.strerror or error}") from None
    return Path(path)


class _WholeFile:
    """A pooch downloader of a file that stands by itself on a web server."""

    def __init__(self, progress: Callable[[int, int], None] | None):
        self.progress = progress

    def __call__(self, url: str, output_file: str | Path, pooch: Any) -> None:
        import requests

        with requests.get(url, timeout=_TIMEOUT, stream=True) as reply, Path(output_file).open("wb") as output:
            reply.raise_for_status()
            size = int(reply.headers.get("Content-Length", 0))
            for block in reply.iter_content(_READ_AHEAD):
                output.write(block)
                if self.progress:
                    self.progress(output.tell(), size)


class _ArchiveMember:
    """A pooch downloader that takes one member out of a remote zip archive."""

    def __init__(self, archive: str, name: str, progress: Callable[[int, int], None] | None):
        self.archive = archive
        self.name = name
        self.progress = progress

    def __call__(self, url: str, output_file: str | Path, pooch: Any) -> None:
        with _RemoteFile(self.archive) as remote, zipfile.ZipFile(remote) as archive:
            member = next((m for m in archive.infolist() if m.filename.rsplit("/", 1)[-1] == self.name), None)
            if member is None:
                raise DownloadError(f"{self.archive} does not contain {self.name}")
            with archive.open(member) as packed, Path(output_file).open("wb") as output:
                while block := packed.read(_READ_AHEAD):
                    output.write(block)
                    if self.progress:
                        self.progress(output.tell(), member.file_size)


class _RemoteFile(io.RawIOBase):
    """A file on a web server, read in blocks by HTTP range requests."""

    def __init__(self, url: str):
        import requests

        self._session = requests.Session()
        self._url = url
        self._position = 0
        self._block = b""
        self._block_start = 0
        self._size = 0
        try:
            self._fetch(0, 0)
        except Exception:
            self.close()
            raise

    def _fetch(self, first: int, last: int) -> bytes:
        headers = {"Range": f"bytes={first}-{last}", "Accept-Encoding": "identity"}
        # streamed, so that a server that ignores the range is noticed before it has sent a gigabyte
        with self._session.get(self._url, headers=headers, timeout=_TIMEOUT, stream=True) as reply:
            reply.raise_for_status()
            if reply.status_code != 206 or "Content-Range" not in reply.headers:
                raise DownloadError(
                    f"{self._url}: this server sends only the whole archive; fetch and unpack it yourself, or name a "
                    "folder of files"
                )
            self._size = int(reply.headers["Content-Range"].rsplit("/", 1)[-1])
            return reply.content

    def close(self) -> None:
        self._session.close()
        super().close()

    def seekable(self) -> bool:
        return True

    def readable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._position

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        start = {io.SEEK_SET: 0, io.SEEK_CUR: self._position, io.SEEK_END: self._size}[whence]
        self._position = start + offset
        return self._position

    def readinto(self, buffer: Any) -> int:
        count = min(len(buffer), self._size - self._position)
        if count <= 0:
            return 0
        start = self._position - self._block_start
        if not 0 <= start < len(self._block):
            last = min(self._position + max(count, _READ_AHEAD), self._size) - 1
            self._block = self._fetch(self._position, last)
            self._block_start, start = self._position, 0
        block = self._block[start : start + count]
        buffer[: len(block)] = block
        self._position += len(block)
        return len(block)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
