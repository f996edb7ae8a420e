"""Fetching MERL files from a server on this machine: a folder, an archive, and everything that can go wrong."""

import contextlib
import hashlib
import http.server
import re
import struct
import threading
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from matcam.core.errors import ArgumentError, DownloadError, OutputError
from matcam.files import downloads
from tests.conftest import SHARED

CONTENT = bytes(range(256)) * 20_000


class Server(http.server.SimpleHTTPRequestHandler):
    """A folder of files, with range requests (which the standard library's server lacks) unless `plain` is set."""

    plain = False
    stops = 0
    """Bytes after which a long answer breaks off; 0: never."""
    requests: list = []  # noqa: RUF012

    answer = None
    """Function (handler, requested range) that answers in place of what is right."""

    def do_GET(self):
        if self.answer:
            return type(self).answer(self, self.headers.get("Range"))
        wanted = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range", ""))
        self.requests.append(self.headers.get("Range"))
        if not wanted or self.plain:
            return super().do_GET()
        try:
            content = Path(self.translate_path(self.path)).read_bytes()
        except FileNotFoundError:
            return self.send_error(404)
        first, last = int(wanted[1]), min(int(wanted[2]), len(content) - 1)
        self.send_response(206)
        self.send_header("Content-Range", f"bytes {first}-{last}/{len(content)}")
        self.send_header("Content-Length", str(last - first + 1))
        self.end_headers()
        part = content[first : last + 1]
        return self.wfile.write(part[: self.stops] if self.stops and len(part) > self.stops else part)

    def log_message(self, *_):
        pass


@pytest.fixture
def server(tmp_path, monkeypatch):
    """Address of a server that offers chrome.binary in folder/ and in database.zip; the published hash is CONTENT's."""
    root = tmp_path / "server"
    (root / "folder").mkdir(parents=True)
    (root / "folder" / "chrome.binary").write_bytes(CONTENT)
    (root / "folder" / "brass.binary").write_bytes(CONTENT[:-1])
    (root / "folder" / "silver.binary").write_bytes(CONTENT[::-1])
    with zipfile.ZipFile(root / "database.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("BRDFDatabase/brdfs/brass.binary", CONTENT * 3)
        archive.writestr("BRDFDatabase/brdfs/chrome.binary", CONTENT)
        archive.writestr("BRDFDatabase/brdfs/silver.binary", CONTENT[::-1])
        archive.writestr("BRDFDatabase/code/readme.txt", "hello")
    (root / "broken.zip").write_bytes(b"no archive" * 100)
    sha256 = hashlib.sha256(CONTENT).hexdigest()
    monkeypatch.setattr(
        downloads, "merl_checksums", lambda: dict.fromkeys(("chrome", "brass", "nickel", "silver"), sha256)
    )
    monkeypatch.setattr(downloads, "_SIZE", len(CONTENT))
    monkeypatch.setattr(Server, "plain", False)
    monkeypatch.setattr(Server, "stops", 0)
    monkeypatch.setattr(Server, "answer", None)
    monkeypatch.setattr(Server, "requests", [])
    handler = lambda *args: Server(*args, directory=str(root))  # noqa: E731
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as running:
        threading.Thread(target=running.serve_forever, args=(0.01,), daemon=True).start()
        yield f"http://127.0.0.1:{running.server_address[1]}"
        running.shutdown()


@pytest.mark.parametrize("source", ["folder", "folder/", "database.zip"])
def test_a_file_arrives_whole_and_is_checked(server, tmp_path, source):
    path = downloads.fetch_merl("chrome", tmp_path / "out", f"{server}/{source}")
    assert path == tmp_path / "out" / "chrome.binary"
    assert path.read_bytes() == CONTENT


def test_the_source_is_a_setting(server, tmp_path, monkeypatch):
    monkeypatch.setenv(downloads.SOURCE_SETTING, f"{server}/folder")
    assert downloads.fetch_merl("chrome", tmp_path).read_bytes() == CONTENT
    assert downloads.MERL_SOURCE.startswith("https://zenodo.org/")


def test_what_is_there_and_right_is_not_fetched_again(server, tmp_path):
    downloads.fetch_merl("chrome", tmp_path, f"{server}/database.zip")
    before = len(Server.requests)
    downloads.fetch_merl("chrome", tmp_path, f"{server}/database.zip")
    assert len(Server.requests) == before
    (tmp_path / "chrome.binary").write_bytes(b"the user's own")
    with pytest.raises(OutputError, match=r"chrome\.binary exists: use force=True"):
        downloads.fetch_merl("chrome", tmp_path, f"{server}/database.zip")
    assert (tmp_path / "chrome.binary").read_bytes() == b"the user's own"
    assert len(Server.requests) == before
    fetched = downloads.fetch_merl("chrome", tmp_path, f"{server}/database.zip", force=True)
    assert fetched.read_bytes() == CONTENT


@pytest.mark.parametrize("source", ["folder", "database.zip"])
def test_progress_counts_to_the_end(server, tmp_path, source):
    seen = []
    downloads.fetch_merl("chrome", tmp_path, f"{server}/{source}", lambda *state: seen.append(state))
    assert seen[-1] == (len(CONTENT), len(CONTENT))


@pytest.mark.parametrize(
    ("material", "source", "words"),
    [
        ("brass", "folder", "the data end after 5119999 of 5120000 bytes"),
        ("silver", "folder", "SHA-256 differs"),
        ("silver", "database.zip", "SHA-256 differs"),
        ("brass", "database.zip", "lists brass.binary with 15360000 bytes, but the published file has 5120000"),
        ("nickel", "folder", "404"),
        ("nickel", "database.zip", "does not contain nickel.binary"),
        ("chrome", "broken.zip", "is not a zip archive"),
        ("chrome", "none.zip", "404"),
    ],
)
def test_what_is_wrong_is_said_and_not_kept(server, tmp_path, material, source, words):
    with pytest.raises(DownloadError) as caught:
        downloads.fetch_merl(material, tmp_path / "out", f"{server}/{source}")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out" / f"{material}.binary").exists()


def test_a_server_without_ranges_and_one_that_is_away(server, tmp_path, monkeypatch):
    monkeypatch.setattr(Server, "plain", True)
    with pytest.raises(DownloadError, match="sends only the whole archive"):
        downloads.fetch_merl("chrome", tmp_path, f"{server}/database.zip")
    with pytest.raises(DownloadError, match="there is no connection to the server; check"):
        downloads.fetch_merl("chrome", tmp_path, "http://127.0.0.1:9/folder")
    with pytest.raises(DownloadError, match="an address must begin with https"):
        downloads.fetch_merl("chrome", tmp_path, "folder")


def test_an_archive_that_breaks_off_or_is_spoiled_inside(server, tmp_path, monkeypatch):
    """The list of members arrives, the member does not."""
    root = tmp_path / "server"
    noise = np.random.default_rng(0).bytes(300_000)
    with zipfile.ZipFile(root / "large.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("chrome.binary", noise)
    monkeypatch.setattr(downloads, "_SIZE", 300_000)
    monkeypatch.setattr(Server, "stops", 100_000)
    with pytest.raises(DownloadError, match=r"chrome: (the file cannot be fetched from )?http.*large.zip: ."):
        downloads.fetch_merl("chrome", tmp_path / "out", f"{server}/large.zip")
    monkeypatch.setattr(Server, "stops", 0)
    whole = bytearray((root / "large.zip").read_bytes())
    whole[1000:2000] = bytes(1000)
    (root / "spoiled.zip").write_bytes(whole)
    with pytest.raises(DownloadError, match="chrome: "):
        downloads.fetch_merl("chrome", tmp_path / "out", f"{server}/spoiled.zip")
    assert not (tmp_path / "out" / "chrome.binary").exists()


def endless(handler, wanted, headers=()):
    """Bytes until the reader goes away."""
    handler.send_response(206 if wanted else 200)
    for name, value in headers:
        handler.send_header(name, value)
    handler.end_headers()
    with contextlib.suppress(OSError):
        while True:
            handler.wfile.write(bytes(1 << 16))
            handler.sent.append(1 << 16)


def dripping(handler, wanted):
    """A byte now and then."""
    handler.send_response(200)
    handler.end_headers()
    with contextlib.suppress(OSError):
        while True:
            handler.wfile.write(b"x")
            time.sleep(0.05)


def ranged(value):
    return lambda handler, wanted: endless(handler, wanted, [("Content-Range", value)])


@pytest.mark.parametrize(
    ("source", "answer", "words"),
    [
        ("folder", endless, "sends more than the 5120000 bytes"),
        ("folder", dripping, "not finished after 1 s"),
        ("a.zip", endless, "answered a request for a range of bytes with ''"),
        (
            "a.zip",
            ranged("bytes 0-0/5000000000"),
            "answered a request for a range of bytes with 'bytes 0-0/5000000000'",
        ),
        ("a.zip", ranged("bytes 0-0/*"), "answered a request for a range of bytes with 'bytes 0-0/*'"),
        ("a.zip", ranged("bytes 0-0/" + 20 * "9"), "answered a request for a range of bytes"),
        ("a.zip", ranged("bytes 0-0/0"), "is not a zip archive"),
        ("a.zip", ranged("bytes 0-0/100"), "is not a zip archive"),
    ],
)
def test_a_server_that_means_harm(server, tmp_path, monkeypatch, source, answer, words):
    """Little is read of what it sends, nothing is left, and it is said in one line."""
    monkeypatch.setattr(Server, "answer", answer)
    monkeypatch.setattr(Server, "sent", [], raising=False)
    monkeypatch.setattr(downloads, "_DEADLINE", 1.0)
    start = time.monotonic()
    with pytest.raises(DownloadError) as caught:
        downloads.fetch_merl("chrome", tmp_path / "out", f"{server}/{source}")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert time.monotonic() - start < 10
    assert sum(Server.sent) < 40e6  # what the system buffers on the way included
    assert list((tmp_path / "out").glob("*")) == []


def test_a_list_of_members_that_claims_gigabytes(server, tmp_path):
    root = tmp_path / "server"
    end = struct.pack("<4s4H2IH", b"PK\5\6", 0, 0, 1, 1, 1 << 31, 0, 0)
    with (root / "large.zip").open("wb") as file:
        file.truncate(1 << 31)  # a hole
        file.seek(0, 2)
        file.write(end)
    with pytest.raises(DownloadError, match="the list of members has 2147483648 bytes"):
        zipfile.ZipFile(downloads._RemoteFile(_HoleWeb(root / "large.zip"), "large.zip"))


class _HoleWeb:
    """Reads of a file on this disk."""

    def __init__(self, path):
        self.path = path

    def size(self, address):
        return self.path.stat().st_size

    def stream(self, address, span):
        with self.path.open("rb") as file:
            file.seek(span[0])
            yield file.read(min(span[1] - span[0] + 1, 1 << 20))


def test_an_interruption_leaves_nothing(server, tmp_path):
    def interrupt(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        downloads.fetch_merl("chrome", tmp_path / "out", f"{server}/folder", interrupt)
    assert list((tmp_path / "out").glob("*")) == []


def test_a_member_is_one_request_whatever_its_size(server, tmp_path):
    downloads.fetch_merl("chrome", tmp_path, f"{server}/database.zip")
    assert len(Server.requests) <= 3  # size, list of members, member


def test_unknown_material_suggests_the_nearest():
    with pytest.raises(ArgumentError, match="unknown MERL material 'crome'; did you mean 'chrome'"):
        downloads.fetch_merl("crome", ".")


def test_packaged_checksums_are_the_published_list():
    assert len(downloads.merl_checksums()) == 100
    assert all(re.fullmatch("[0-9a-f]{64}", value) for value in downloads.merl_checksums().values())
    published = SHARED / "data" / "merl_sha256.txt"
    if not published.exists():
        pytest.skip("published list not beside the checkout (shared/data)")
    ours = downloads.resources.files("matcam").joinpath("data/merl_sha256.txt").read_text()
    assert ours == published.read_text()
