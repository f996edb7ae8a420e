"""The fuzzer itself finds what is there to be found."""

from matcam.core.errors import FileFormatError
from tests.files import fuzz, text_readers


def _planted(path):
    text = path.read_text(errors="replace")
    if "a" not in text:
        raise FileFormatError(f"{path}: no a")
    return 1 / len(text.split("1")[0]) if text.count("1") > 3 else 0  # fails where it begins with 1


def test_a_planted_fault_is_found(tmp_path, monkeypatch):
    monkeypatch.setitem(text_readers.TEXTS, "planted", (lambda path: path.write_text("a 1 b 1"), "a.txt", _planted))
    monkeypatch.setattr(fuzz, "PACKAGE", __file__)
    count, first, last, corpus, _, faults = fuzz.fuzz("planted", tmp_path / "a", 20.0, seed=1, enough=1)
    assert last > first
    assert corpus > 1
    assert count > 10
    assert faults[0][1].startswith("ZeroDivisionError")


def test_a_reader_of_the_package_stands(tmp_path):
    *_, first, last, corpus, _, faults = fuzz.fuzz("rig.toml", tmp_path / "a", 0.5, seed=1)
    assert last > first
    assert corpus > 1
    assert faults == []
