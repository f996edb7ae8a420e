"""The draw of docstrings and messages: repeatable, without repetition, and from all sources."""

import pytest

import docs_draw
from docs_messages import SOURCES


@pytest.mark.slow
def test_a_seed_repeats_its_draw():
    assert docs_draw.draw(1, 20) == docs_draw.draw(1, 20)
    assert docs_draw.draw(1, 20) != docs_draw.draw(2, 20)


def test_a_draw_repeats_no_text():
    for texts in docs_draw.draw(3):
        assert len(set(texts)) == docs_draw.COUNT


def test_texts_are_at_their_positions():
    for texts in docs_draw.draw(4, 10):
        for text in texts:
            path, _, line = text.position.partition(":")
            following = "\n".join((SOURCES / path).read_text(encoding="utf-8").splitlines()[int(line) - 1 :])
            first = text.text.partition("{")[0].split("\n")[0][:20]
            assert first in following


def test_all_packages_are_drawn_from():
    folders = {path.parent.name for path in SOURCES.rglob("*.py") if path.name != "__init__.py"}
    drawn = {part for text in docs_draw.docstrings() for part in text.position.split("/")[:-1]}
    assert folders - {SOURCES.name} <= drawn
