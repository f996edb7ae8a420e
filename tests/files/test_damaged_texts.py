"""Damaged texts: an error of the family in one line or a result, never a crash, a hang or a memory bomb."""

import time

import pytest

from tests.files.mutations import mutated_text, survives
from tests.files.text_readers import TEXTS, sound

SPARE = 4 << 20
"""What a text may cost beyond four times its size, bytes: schemas, and what the interpreter keeps."""


@pytest.mark.parametrize("name", TEXTS)
@pytest.mark.parametrize("count", [200, pytest.param(10_000, marks=pytest.mark.slow)])
def test_damaged_texts(tmp_path, name, count):
    path = sound(name, tmp_path / "a")
    read = TEXTS[name][2]
    read(path)
    refused, accepted = survives(
        read, path, mutated_text(path.read_bytes(), count, 7), spare=SPARE, clock=time.process_time
    )
    assert accepted > 0
    assert refused > count / 20 or name == "record"  # one that is damaged is no error: its material is done again


def test_a_record_with_a_number_that_no_float_holds(tmp_path):
    """As `make fuzz` found it."""
    path = sound("record", tmp_path / "a")
    path.write_text('{"fit": {"params": {"alpha": 1%s}}, "supported_share": 0.5}' % ("0" * 400))
    labels = TEXTS["record"][2](path)
    assert not any("alpha" in label for label in labels)
