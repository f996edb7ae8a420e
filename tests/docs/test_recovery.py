"""The pages of the recovery benchmark and the README agree with its result file."""

import json
import re
from pathlib import Path

import pytest
import yaml
from benchmarks.recovery import __main__ as command
from benchmarks.recovery import cases, page, photographs, run

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def scores():
    return json.loads(command.RESULTS.read_text(encoding="utf-8"))["scores"]


@pytest.fixture(scope="module")
def of_photographs():
    return command.published()["photographs"]


def test_pages_and_readme_are_those_of_the_results():
    generated = command.generated()
    assert len(generated) == 4
    for path, blocks in generated.items():
        text = path.read_text(encoding="utf-8")
        assert blocks
        assert page.with_blocks(text, blocks) == text, f"write {path.name} again: python -m benchmarks.recovery page"


def test_every_method_has_a_score_of_the_same_public_cases(scores):
    names = [case.name for case in cases.PUBLIC]
    assert set(scores) <= set(run.METHODS)
    assert {*run.METHODS[:-1]} <= set(scores)
    for of_cases in scores.values():
        assert list(of_cases) == [name for name in names if name in scores[run.OWN]]
    assert f"| public cases with a score of every method | 24 | {len(scores[run.OWN])} |" in command.PAGE.read_text()


def test_every_method_has_a_score_of_all_photographs(of_photographs):
    assert {*run.METHODS[:-1]} <= set(of_photographs) <= set(run.METHODS)
    for of_cases in of_photographs.values():
        assert list(of_cases) == [case.name for case in photographs.PUBLIC]


def test_the_page_names_every_case(scores, of_photographs):
    text = command.PAGE.read_text(encoding="utf-8") + command.PHOTOGRAPHS.read_text(encoding="utf-8")
    assert [name for name in (*scores[run.OWN], *of_photographs[run.OWN]) if f"| `{name}` |" not in text] == []


def test_the_hash_of_the_hidden_seeds_is_published():
    assert re.fullmatch(r"[0-9a-f]{64}  24 seeds, one in each line\n", command.HASH.read_text())


def test_the_citation_is_valid():
    citation = yaml.safe_load((ROOT / "benchmarks" / "recovery" / "CITATION.cff").read_text())
    whole = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["type"] == "dataset"
    for field in ("cff-version", "version", "license", "authors", "references"):
        assert citation[field] == whole[field]
