"""A file appears whole under its final name, or not at all."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from matcam.core import io
from matcam.core.errors import ArgumentError, OutputError
from matcam.core.io import (
    all_or_nothing,
    check_output,
    make_folder,
    one_by_one,
    replacing,
    uninterrupted,
    where_written,
)


def test_failure_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(RuntimeError), replacing(path, force=True) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_interruption_leaves_nothing(tmp_path):
    with pytest.raises(KeyboardInterrupt), replacing(tmp_path / "a.txt") as temporary:
        temporary.write_text("half")
        raise KeyboardInterrupt
    assert os.listdir(tmp_path) == []


def test_success_keeps_suffix_and_ordinary_permissions(tmp_path):
    with replacing(tmp_path / "deep" / "a.tar.gz") as temporary:
        assert temporary.suffix == ".gz"
        temporary.write_text("x")
    mask = os.umask(0)
    os.umask(mask)
    assert (tmp_path / "deep" / "a.tar.gz").stat().st_mode & 0o777 == 0o666 & ~mask


def test_the_input_is_never_the_output_whatever_its_name(tmp_path):
    source = tmp_path / "a.txt"
    source.write_text("x")
    (tmp_path / "link.txt").symlink_to(source)
    for name in (source, tmp_path / "link.txt", tmp_path / "." / "a.txt"):
        with pytest.raises(OutputError, match="is the input itself"):
            check_output(name, force=True, inputs=[source])


def test_full_disk_is_said_in_one_line(tmp_path):
    """A limit on the file size stands in for a full disk."""
    code = (
        "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        "from matcam.core.io import replacing\nfrom matcam.core.errors import OutputError\n"
        "try:\n  with replacing(sys.argv[1]) as t: t.write_bytes(bytes(5000))\n"
        "except OutputError as e: print(e)"
    )
    result = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "a.bin")], capture_output=True, text=True, check=True
    )
    assert "cannot be written: File too large" in result.stdout
    assert os.listdir(tmp_path) == []


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_folder_without_permission(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(OutputError, match="no permission to write into"):
        check_output(tmp_path / "new" / "a.txt")


def test_a_folder_without_permission_is_found_before_the_work(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != tmp_path)
    with pytest.raises(OutputError, match=f"no permission to write into {tmp_path}"):
        check_output(tmp_path / "new" / "a.txt")


def write(path, text="new", **options):
    with replacing(path, **options) as temporary:
        temporary.write_text(text)


def test_files_appear_together(tmp_path):
    with all_or_nothing():
        write(tmp_path / "a.txt")
        with all_or_nothing():  # belongs to the outer one
            write(tmp_path / "b.txt")
        assert not list(tmp_path.glob("[!.]*"))
        assert where_written(tmp_path / "a.txt").read_text() == "new"
        with pytest.raises(OutputError, match="is given twice"):
            write(tmp_path / "a.txt")
        write(tmp_path / "a.txt", "newer", force=True)
        with one_by_one():
            write(tmp_path / "c.txt")
        assert (tmp_path / "c.txt").exists()
    assert sorted(os.listdir(tmp_path)) == ["a.txt", "b.txt", "c.txt"]
    assert (tmp_path / "a.txt").read_text() == "newer"


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_or_none_of_them(tmp_path, error):
    (tmp_path / "a.txt").write_text("old")
    with pytest.raises(error), all_or_nothing():
        write(tmp_path / "a.txt", force=True)
        write(tmp_path / "b.txt")
        raise error
    assert os.listdir(tmp_path) == ["a.txt"]
    assert (tmp_path / "a.txt").read_text() == "old"


def test_a_name_that_cannot_be_had_undoes_the_others(tmp_path):
    """The third becomes a folder while the files are written."""
    (tmp_path / "a.txt").write_text("old")
    with pytest.raises(OutputError, match=r"c\.txt cannot be written"), all_or_nothing():
        write(tmp_path / "a.txt", force=True)
        write(tmp_path / "b.txt")
        write(tmp_path / "c.txt")
        (tmp_path / "c.txt").mkdir()
    assert sorted(os.listdir(tmp_path)) == ["a.txt", "c.txt"]
    assert (tmp_path / "a.txt").read_text() == "old"


@pytest.mark.parametrize("name", ["a\n.txt", "\x1b]0;title\x07.txt", "a\udcff.txt", "a\u202etxt.exe"])
def test_a_name_that_is_no_text(tmp_path, name):
    with pytest.raises(OutputError, match="has a name that is not plain text") as caught:
        check_output(tmp_path / name)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_signals_wait_for_what_must_not_be_interrupted(name):
    def end(number, frame):
        raise KeyboardInterrupt

    number, done = getattr(signal, name), []
    before = signal.signal(number, end)
    try:
        with pytest.raises(KeyboardInterrupt), uninterrupted():
            signal.raise_signal(number)
            done.append("all of it")
        assert done == ["all of it"]
        assert signal.getsignal(number) is end
        with pytest.raises(ValueError, match="of its own"), uninterrupted():
            raise ValueError("an error of its own")
        assert signal.getsignal(number) is end
    finally:
        signal.signal(number, before)


def interrupted_at(line, call):
    """Call something and send Ctrl-C at the so manieth line of core/io.py that it executes: (whether it came, the error)."""
    count = 0

    def trace(frame, event, argument):
        nonlocal count
        if frame.f_code.co_filename != io.__file__:
            return None
        if event == "line":
            count += 1
            if count == line:
                signal.raise_signal(signal.SIGINT)
        return trace

    error = None
    sys.settrace(trace)
    try:
        call()
    except (KeyboardInterrupt, RuntimeError) as caught:
        error = type(caught)
    finally:
        sys.settrace(None)
    return count >= line, error


def write_two(folder, fails):
    with all_or_nothing():
        write(folder / "a.txt", force=True)
        write(folder / "deep" / "b.txt", force=True)
        if fails:
            raise RuntimeError


def write_one(folder, fails):
    with replacing(folder / "a.txt", force=True) as temporary:
        temporary.write_text("new")
        if fails:
            raise RuntimeError


@pytest.mark.parametrize("fails", [False, True])
@pytest.mark.parametrize("call", [write_two, write_one])
def test_an_interruption_at_any_line_leaves_all_or_nothing(tmp_path, call, fails):
    """No orphan, no folder, no file without the other; and the next one is written."""
    before, old, new = signal.getsignal(signal.SIGINT), {"a.txt": "old"}, {"a.txt": "new"}
    if call is write_two:
        new |= {"deep": None, "deep/b.txt": "new"}
    line, outcomes = 0, []
    came = True
    while came:
        line += 1
        folder = tmp_path / str(line)
        folder.mkdir()
        (folder / "a.txt").write_text("old")
        came, error = interrupted_at(line, lambda folder=folder: call(folder, fails))
        left = {str(p.relative_to(folder)): p.read_text() if p.is_file() else None for p in folder.rglob("*")}
        assert left in (old, new), line
        assert left == old or not fails
        assert signal.getsignal(signal.SIGINT) is before
        if came:
            outcomes.append((error, left == new))
        write(folder / "c.txt")
        assert (folder / "c.txt").read_text() == "new"
    assert len(outcomes) > 40
    assert {error for error, _ in outcomes} <= {KeyboardInterrupt, RuntimeError}
    if not fails:
        assert {done for _, done in outcomes} == {False, True}
        assert all(error is KeyboardInterrupt for error, _ in outcomes)


def test_what_an_interruption_between_two_statements_has_left_goes_at_the_end(tmp_path):
    """The exception comes where no signal can come: within what removes."""
    code = (
        "import sys\nfrom pathlib import Path\nfrom matcam.core import io\n"
        "io.Outputs.publish = lambda self: sys.exit(3)\n"
        "discard, calls = io.Outputs.discard, []\n"
        "def interrupted(self):\n    calls.append(1)\n"
        "    if len(calls) == 1: raise KeyboardInterrupt\n    discard(self)\n"
        "io.Outputs.discard = interrupted\n"
        "with io.replacing(Path(sys.argv[1])) as temporary: temporary.write_text('half')\n"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "a.txt")], capture_output=True, check=False)
    assert os.listdir(tmp_path) == []


def test_folders_vanish_with_the_files_that_do_not_appear(tmp_path):
    with pytest.raises(RuntimeError), all_or_nothing():
        make_folder(tmp_path / "a" / "b")
        write(tmp_path / "c" / "d.txt")
        (tmp_path / "c" / "mine").write_text("mine")
        raise RuntimeError
    assert sorted(str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*")) == ["c", "c/mine"]


@pytest.mark.parametrize("force", ["no", 1, None, "True"])
def test_force_is_true_or_false(tmp_path, force):
    with pytest.raises(ArgumentError, match="force must be True or False"):
        check_output(tmp_path / "a.txt", force=force)


def test_a_link_that_leads_nowhere_is_there(tmp_path):
    (tmp_path / "a.txt").symlink_to(tmp_path / "nowhere")
    with pytest.raises(OutputError, match="exists"):
        write(tmp_path / "a.txt")
    write(tmp_path / "a.txt", force=True)
    assert not (tmp_path / "a.txt").is_symlink()
    assert not (tmp_path / "nowhere").exists()


@pytest.mark.parametrize("letter", ["x", "\N{GREEK SMALL LETTER ALPHA}"])
def test_names_up_to_what_the_file_system_allows(tmp_path, letter):
    size = len(letter.encode())
    longest = letter * ((255 - 4) // size) + ".txt"
    write(tmp_path / longest)
    write(tmp_path / longest, force=True)
    assert (tmp_path / longest).read_text() == "new"
    with pytest.raises(OutputError, match="File name too long"):
        write(tmp_path / (letter + longest))
