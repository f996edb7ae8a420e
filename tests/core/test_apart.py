"""Files are decoded in a process of its own: whatever a decoder does there, here it is an error of one line, or an answer."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.readers import apart
from matcam.core.readers.apart import Limits, read_apart, reading_limits

HERE = "tests.core.misbehaving"


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "a.file"
    path.write_bytes(b"abc")
    return path


def one_line(error):
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("alone", [False, True])
def test_an_answer_comes_back_as_it_was(path, alone, monkeypatch):
    if alone:
        monkeypatch.setattr(apart, "_CAN_FORK", False)
    answer = read_apart(f"{HERE}:everything", path, scale=2.0)
    np.testing.assert_array_equal(answer["floats"], np.arange(12.0).reshape(3, 4) * 2)
    np.testing.assert_array_equal(answer["fortran"], np.arange(12).reshape(3, 4))
    np.testing.assert_array_equal(answer["strided"], [0, 2, 4, 6, 8, 10])
    assert answer["empty"].shape == (0, 3)
    assert answer["empty"].dtype == np.float32
    assert answer["scalar"] == 2.5
    assert answer["flags"].tolist() == [True, False]
    assert answer["text"].tolist() == ["red", "green"]
    assert answer["objects"].tolist() == ["a", "bc"]
    assert answer["nothing"] is None
    assert answer["list"] == [1, "two", 3.5, float("inf"), [True]]
    assert answer["process"] != os.getpid()


def test_a_trusted_file_is_decoded_here(path):
    with reading_limits(None):
        assert read_apart(f"{HERE}:everything", path)["process"] == os.getpid()
    assert read_apart(f"{HERE}:everything", path)["process"] != os.getpid()


@pytest.mark.parametrize(("decoder", "limits"), [("hang", Limits(wall=1.0)), ("spin", Limits(seconds=1.0))])
def test_a_decoder_that_never_ends_is_killed(path, decoder, limits):
    begin = time.monotonic()
    with reading_limits(limits), pytest.raises(FileFormatError) as error:
        read_apart(f"{HERE}:{decoder}", path)
    assert time.monotonic() - begin < (5 if decoder == "hang" else 30)
    assert str(path) in one_line(error)
    assert "more than 1 s" in one_line(error)
    assert ("processor time" in one_line(error)) == (decoder == "spin")


def test_a_busy_machine_is_no_fault_of_the_file(path):
    """A decoder that waits longer than it may work: what counts is processor time."""
    begin = time.monotonic()
    with reading_limits(Limits(seconds=0.5)):
        assert read_apart(f"{HERE}:wait", path) == "read"
    assert time.monotonic() - begin > 1.0


def test_a_decoder_that_crashes_takes_nothing_with_it(path):
    with pytest.raises(FileFormatError, match="crashed") as error:
        read_apart(f"{HERE}:crash", path)
    assert str(path) in one_line(error)
    assert read_apart(f"{HERE}:everything", path)["scalar"] == 2.5


def test_a_decoder_that_fills_the_memory_is_stopped(path):
    with reading_limits(Limits(memory=1 << 28)), pytest.raises(FileFormatError, match="256 MiB") as error:
        read_apart(f"{HERE}:fill", path)
    assert str(path) in one_line(error)


def test_a_decoder_cannot_write(path):
    with pytest.raises(FileFormatError):
        read_apart(f"{HERE}:write", path)
    assert not path.with_name("a.file.written").exists() or not path.with_name("a.file.written").stat().st_size


@pytest.mark.parametrize(
    ("decoder", "kind", "text"),
    [
        ("refuse", FileFormatError, "byte 7 is wrong"),
        ("argue", ArgumentError, "sampling must be centre or edge"),
        ("complain", FileFormatError, "damaged: two lines"),
        ("pickled", FileFormatError, "damaged: an answer cannot contain object"),
    ],
)
def test_errors_come_back_as_they_were(path, decoder, kind, text):
    with pytest.raises(kind, match=text) as error:
        read_apart(f"{HERE}:{decoder}", path)
    one_line(error)


@pytest.mark.parametrize("trusted", [False, True])
@pytest.mark.parametrize(
    ("decoder", "text"),
    [
        ("complain", "the file is damaged, or not a picture: two lines"),
        (
            "complain_as_a_library",
            "the file is damaged, or not a picture: Unable to open file (truncated file: eof = 96)",
        ),
        ("complain_of_the_system", "cannot be read: Permission denied"),
        ("refuse", "byte 7 is wrong"),
    ],
)
def test_whatever_a_decoder_raises_is_one_line(path, trusted, decoder, text):
    with reading_limits(None if trusted else Limits()), pytest.raises(FileFormatError) as error:
        read_apart(f"{HERE}:{decoder}", path, "a picture")
    assert str(error.value) == f"{path}: {text}"


def test_a_trusted_file_that_fills_the_memory(path):
    with reading_limits(None), pytest.raises(FileFormatError, match="needs more memory than is available"):
        read_apart(f"{HERE}:run_out", path)


@pytest.mark.parametrize("trusted", [False, True])
def test_what_is_no_file_is_refused_before_its_decoder_is_called(path, trusted):
    with reading_limits(None if trusted else Limits()):
        for wrong, words in (
            (path.parent, "the input is a folder, not a picture"),
            (path.with_name("none"), "no such file"),
        ):
            with pytest.raises(FileFormatError) as error:
                read_apart(f"{HERE}:everything", wrong, "a picture", small=1 << 20)
            assert str(error.value) == f"{wrong}: {words}"


@pytest.mark.parametrize("alone", [False, True])
def test_messages_name_the_file_as_it_was_given(path, alone, monkeypatch):
    """Also from a folder into which the caller went after the first file."""
    read_apart(f"{HERE}:everything", path)
    if alone:
        monkeypatch.setattr(apart, "_CAN_FORK", False)
    monkeypatch.chdir(path.parent)
    for given in ("a.file", "./../" + path.parent.name + "/a.file"):
        with pytest.raises(FileFormatError) as error:
            read_apart(f"{HERE}:refuse", Path(given))
        assert str(error.value) == f"{Path(given)}: byte 7 is wrong"


def test_the_nursery_may_die(path):
    read_apart(f"{HERE}:everything", path)
    os.kill(apart._nursery.process.pid, signal.SIGKILL)
    apart._nursery.process.wait()
    assert read_apart(f"{HERE}:everything", path)["scalar"] == 2.5


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_reader_that_is_killed_from_outside_is_no_fault_of_the_file(path, number):
    assert read_apart(f"{HERE}:end_as", path, number=int(number), once=True) == "read"
    with pytest.raises(FileFormatError, match="ended from outside, twice") as error:
        read_apart(f"{HERE}:end_as", path, number=int(number))
    assert "damaged" not in one_line(error)


@pytest.mark.skipif(not hasattr(os, "waitid"), reason="whether a process is stopped is not known here")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_nursery_that_is_killed_or_stopped_while_it_reads_is_replaced(path, number):
    begin = time.monotonic()
    assert read_apart(f"{HERE}:end_nursery", path, number=int(number)) == "read"
    assert time.monotonic() - begin < 30


@pytest.mark.skipif(not hasattr(os, "waitid"), reason="whether a process is stopped is not known here")
def test_a_nursery_that_was_stopped_is_replaced(path):
    before = read_apart(f"{HERE}:everything", path)["process"]
    os.kill(apart._nursery.process.pid, signal.SIGSTOP)
    assert read_apart(f"{HERE}:everything", path)["process"] != before


def test_a_text_that_is_longer_than_all_others_is_stopped(path):
    """An array of texts has room for the longest in each of its places."""
    with pytest.raises(FileFormatError, match="needs more than"):
        read_apart(f"{HERE}:long_texts", path)


def test_one_rule_limits_memory_and_time_by_the_size_of_the_file(path):
    with pytest.raises(FileFormatError, match="512 MiB"):
        read_apart(f"{HERE}:fill", path)
    with pytest.raises(FileFormatError, match="more than 2 s of processor time"):
        read_apart(f"{HERE}:spin", path)


def test_a_small_file_is_parsed_here(path):
    assert read_apart(f"{HERE}:everything", path, small=3)["process"] == os.getpid()
    assert read_apart(f"{HERE}:everything", path, small=2)["process"] != os.getpid()
    path.write_bytes(b"")
    assert read_apart(f"{HERE}:everything", path)["process"] != os.getpid()  # by the rule, an empty file too


@pytest.mark.skipif(not hasattr(os, "register_at_fork"), reason="needs fork")
def test_a_fork_reads_while_threads_of_its_parent_read(tmp_path):
    """In a process of its own, because a fork that hangs would hang the tests."""
    (tmp_path / "a.file").write_bytes(b"abc")
    code = (
        "import os, sys, threading\nfrom pathlib import Path\nfrom matcam.core.readers.apart import read_apart\n"
        f"def read(): return read_apart('{HERE}:everything', Path(sys.argv[1]))['scalar'] == 2.5\n"
        "stop = threading.Event()\n"
        "def work():\n    while not stop.is_set(): read()\n"
        "threads = [threading.Thread(target=work) for _ in range(3)]\n"
        "for thread in threads: thread.start()\n"
        "children = []\n"
        "for _ in range(12):\n    child = os.fork()\n    if not child:\n        os._exit(0 if read() else 1)\n"
        "    children.append(child)\n"
        "codes = [os.waitpid(child, 0)[1] for child in children]\n"
        "stop.set()\nfor thread in threads: thread.join()\nsys.exit(codes != [0] * 12)"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code, str(tmp_path / "a.file")],
        env=environment, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


def test_threads_read_side_by_side(path):
    answers = []

    def read():
        answers.extend(read_apart(f"{HERE}:everything", path)["floats"].sum() for _ in range(10))

    threads = [threading.Thread(target=read) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert answers == [66.0] * 40
