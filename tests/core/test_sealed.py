"""Files of a cache: whole or not at all, for one user alone, and nothing of anybody else's is read, followed or removed."""

import os
import shutil
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import pytest

from matcam.core.sealed import read_sealed, remove_sealed, sealed_files, write_sealed
from matcam.core.workspace import Workspace, user_cache_folder

pytestmark = pytest.mark.skipif(not hasattr(os, "getuid"), reason="files have no owners here")
KEY = b"key"


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "cache" / "rules" / "a.npz"
    write_sealed(path, KEY, b"content")
    assert read_sealed(path, KEY) == b"content"
    return path


@pytest.mark.parametrize("mask", [0o000, 0o022, 0o077])
def test_files_and_folders_are_this_user_s_alone_whatever_the_mask(tmp_path, mask):
    before = os.umask(mask)
    try:
        path = tmp_path / "cache" / "rules" / "a.npz"
        write_sealed(path, KEY, b"content")
    finally:
        os.umask(before)
    assert [one.stat().st_mode & 0o777 for one in (path, path.parent, path.parents[1])] == [0o600, 0o700, 0o700]
    assert read_sealed(path, KEY) == b"content"


@pytest.mark.parametrize("mode", [0o666, 0o660, 0o602])
def test_a_file_that_others_may_write(path, mode, caplog):
    path.chmod(mode)
    assert read_sealed(path, KEY) is None
    write_sealed(path, KEY, b"content")  # made again, for this user alone
    assert read_sealed(path, KEY) == b"content"
    assert len(caplog.messages) == 1


@pytest.mark.parametrize("mode", [0o777, 0o770, 0o1777])
def test_a_folder_that_others_may_write(path, mode, caplog):
    path.parent.chmod(mode)
    for _ in range(3):
        assert read_sealed(path, KEY) is None
        write_sealed(path.with_name("b.npz"), KEY, b"content")
    assert not path.with_name("b.npz").exists()
    assert sealed_files(path.parent) == {}
    assert len(caplog.messages) == 1
    assert "chmod" in caplog.text


def test_a_folder_that_others_may_rename(path):
    path.parents[1].chmod(0o777)
    assert read_sealed(path, KEY) is None
    path.parents[1].chmod(0o1777)  # sticky, as /tmp
    assert read_sealed(path, KEY) == b"content"


def test_another_user_s_folder(path, monkeypatch):
    owner = path.stat().st_uid
    monkeypatch.setattr(os, "getuid", lambda: owner + 1)
    assert (read_sealed(path, KEY) is None) == (owner != 0)  # root may change everything anyway


def test_links_are_not_followed(path, tmp_path):
    victim = tmp_path / "victim" / "a.npz"
    write_sealed(victim, KEY, b"content")
    path.unlink()
    path.symlink_to(victim)
    assert read_sealed(path, KEY) is None
    write_sealed(path, KEY, b"other")  # replaces the link
    assert read_sealed(victim, KEY) == b"content"
    folder = tmp_path / "cache" / "link"
    folder.symlink_to(victim.parent)
    assert read_sealed(folder / "a.npz", KEY) is None
    assert sealed_files(folder) == {}
    remove_sealed(folder, ["a.npz"])
    write_sealed(folder / "b.npz", KEY, b"content")
    Workspace(folder, files=0).store("rig", lambda: {"a": KEY and __import__("numpy").zeros(1)})
    assert os.listdir(victim.parent) == ["a.npz"]


def test_a_pipe_is_not_waited_for(path):
    path.unlink()
    os.mkfifo(path)
    assert read_sealed(path, KEY) is None


def test_a_folder_that_another_takes_the_position_of(path, tmp_path):
    """What is checked is what is read: 300 swaps between a folder of this user and one that anybody may write."""
    forged = tmp_path / "cache" / "forged"
    write_sealed(forged / "a.npz", KEY, b"forged")
    forged.chmod(0o777)
    aside, stop = path.parent.with_name("aside"), threading.Event()

    def swap():
        while not stop.is_set():
            path.parent.rename(aside)
            forged.rename(path.parent)
            path.parent.rename(forged)
            aside.rename(path.parent)

    thread = threading.Thread(target=swap)
    thread.start()
    try:
        found = {read_sealed(path, KEY) for _ in range(20_000)}
    finally:
        stop.set()
        thread.join()
    assert b"content" in found
    assert b"forged" not in found


def test_a_relative_cache_folder_is_ignored(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", "here")
    assert user_cache_folder().is_absolute()
    assert tmp_path not in user_cache_folder().parents


_USER = """
import logging, os, sys
sys.path[:0] = sys.argv[2:]
from matcam.core.io import user_cache_folder
from matcam.core.sealed import read_sealed, write_sealed
if sys.argv[1] != "0":  # now that all is imported, which this user may not be able to read
    os.setgroups([]); os.setgid(int(sys.argv[1])); os.setuid(int(sys.argv[1]))
os.umask(0)
path = user_cache_folder() / "rules" / "a.npz"
made = 0
for _ in range(2):
    if read_sealed(path, b"key") is None:
        made += 1
        write_sealed(path, b"key", bytes(1_000_000))
print(made)
"""


def as_user(number, folder):
    return subprocess.Popen(
        [sys.executable, "-c", _USER, str(number), *(p for p in sys.path if p)], text=True,
        env={**os.environ, "XDG_CACHE_HOME": str(folder), "HOME": "/nonexistent"},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can be two users")
def test_two_users_of_one_folder():
    """The second may not read what the first has written, even where the first lets everybody read it."""
    folder = Path(tempfile.mkdtemp(dir="/tmp"))
    try:
        folder.chmod(0o1777)
        assert as_user(1001, folder).communicate() == ("1\n", "")
        assert as_user(1002, folder).communicate() == ("2\n", "")
        (folder / "matcam").chmod(0o755)
        (folder / "matcam" / "rules").chmod(0o755)
        (folder / "matcam" / "rules" / "a.npz").chmod(0o644)
        made, said = as_user(1002, folder).communicate()
        assert made == "2\n"
        assert said.count("\n") == said.count("is not used") == 1
    finally:
        shutil.rmtree(folder)


def test_eight_processes_on_one_empty_cache(tmp_path):
    runs = [as_user(0, tmp_path) for _ in range(8)]
    for run in runs:
        out, said = run.communicate()
        assert (run.returncode, said) == (0, "")
        assert out in ("0\n", "1\n")
    assert len(os.listdir(tmp_path / "matcam" / "rules")) == 1
