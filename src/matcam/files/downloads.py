"""Downloads of published measurements, checked against their published checksums."""

from __future__ import annotations

import os
import zipfile
import zlib
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
_BLOCK = 1 << 20  # bytes between two reports of progress


@cache
def merl_checksums() -> dict[str, str]:
    """Return the SHA-256 of the 100 published MERL files, by material."""
    lines = resources.files("matcam").joinpath("data/merl_sha256.txt").read_text(encoding="ascii").splitlines()
    return {name.removesuffix(".binary"): sha256 for sha256, _, name in (line.split() for line in lines)}


def fetch_merl(
    material: str, folder: str | Path, source: str | None = None, progress: Callable[[int, int], None] | None = None
) -> Path:
    """Fetch one published MERL file and check it.

    A file that is there and is right is kept. Nothing is left under the final name where something goes wrong.

    Args:
        material: name as published, such as "chrome".
        folder: folder to put NAME.binary into.
        source: an archive (ending in .zip) or folder on another server. Default: None, `SOURCE_SETTING`, else `MERL_SOURCE`.
        progress: function that is called with (done, total) bytes. Default: None.

    Returns:
        Path of the file.

    Raises:
        ArgumentError: the material is unknown; the message names the nearest.
        DownloadError: the file cannot be had, or is not, by its SHA-256, the published one.
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
    """Fetch a file that stands by itself on a web server, as a pooch downloader."""

    def __init__(self, progress: Callable[[int, int], None] | None):
        self.progress = progress

    def __call__(self, url: str, output_file: str | Path, pooch: Any) -> None:
        import requests

        with requests.get(url, timeout=_TIMEOUT, stream=True) as reply, Path(output_file).open("wb") as output:
            reply.raise_for_status()
            size = int(reply.headers.get("Content-Length", 0))
            for block in reply.iter_content(_BLOCK):
                output.write(block)
                if self.progress:
                    self.progress(output.tell(), size)


class _ArchiveMember:
    """Take one member out of a remote zip archive, as a pooch downloader, by range requests."""

    def __init__(self, archive: str, name: str, progress: Callable[[int, int], None] | None):
        self.archive = archive
        self.name = name
        self.progress = progress

    def __call__(self, url: str, output_file: str | Path, pooch: Any) -> None:
        import remotezip
        import requests
        import urllib3

        headers = {"Accept-Encoding": "identity"}

        class Fetcher(remotezip.RemoteFetcher):
            def get_file_size(self) -> int:
                """Ask by a range request, too: some servers answer HEAD differently, or not at all."""
                first = {**headers, "Range": "bytes=0-0"}
                with session.get(self._url, headers=first, timeout=_TIMEOUT, stream=True) as reply:
                    reply.raise_for_status()
                    if reply.status_code != 206 or "Content-Range" not in reply.headers:
                        raise remotezip.RangeNotSupported
                    return int(reply.headers["Content-Range"].rsplit("/", 1)[-1])

            def fetch(self, data_range: Any, stream: bool = False) -> Any:
                """Raise what is no OSError, which zipfile would take for a damaged archive."""
                try:
                    return super().fetch(data_range, stream)
                except requests.exceptions.RequestException as error:
                    raise remotezip.RemoteIOError(str(error)) from None

        try:
            with (
                requests.Session() as session,
                remotezip.RemoteZip(
                    self.archive,
                    session=session,
                    fetcher=Fetcher,
                    support_suffix_range=False,
                    headers=headers,
                    timeout=_TIMEOUT,
                ) as archive,
            ):
                member = next((m for m in archive.infolist() if m.filename.rsplit("/", 1)[-1] == self.name), None)
                if member is None:
                    raise DownloadError(f"{self.archive} does not contain {self.name}")
                with archive.open(member) as packed, Path(output_file).open("wb") as output:
                    while block := packed.read(_BLOCK):
                        output.write(block)
                        if self.progress:
                            self.progress(output.tell(), member.file_size)
        except remotezip.RangeNotSupported:
            raise DownloadError(
                f"{self.archive}: this server sends only the whole archive; fetch and unpack it yourself, or name a "
                "folder of files"
            ) from None
        except (remotezip.RemoteZipError, urllib3.exceptions.HTTPError, EOFError, zlib.error) as error:
            raise requests.exceptions.ConnectionError(str(error) or "the archive broke off") from None


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
