"""Runs: resumed, repeated, scored as an entry, and shown."""

import json
import re
import subprocess
import sys

import numpy as np
import pytest
from benchmarks.recovery import __main__ as command
from benchmarks.recovery import cases, entries, generate, page, run, scoring, summary

from matcam.core.grid import brdf_table
from tests.recovery.synthetic import CASE, table

FEW = ("do nothing", "peak over its loss")


@pytest.fixture
def made(monkeypatch):
    """Names of the cases whose table was made."""
    names = []
    monkeypatch.setattr(generate, "table", lambda case, folder=None: names.append(case.name) or table())
    return names


def test_a_second_run_computes_what_is_missing(tmp_path, made, monkeypatch):
    first = run.scores([CASE], FEW[:1], tmp_path, say=lambda line: None)
    assert made == ["synthetic"]
    assert run.scores([CASE], FEW[:1], tmp_path, say=lambda line: None) == first
    assert made == ["synthetic"]
    more = run.scores([CASE], FEW, tmp_path, say=lambda line: None)
    assert made == ["synthetic"] * 2
    assert {m: more[m] for m in FEW[:1]} == first
    # another case of this name is another score
    other = CASE._replace(table=CASE.table._replace(relative=0.5))
    assert not run.score_path(other, FEW[0], tmp_path).exists()


def test_a_repeated_run_gives_the_same(tmp_path, made):
    one, two = (run.scores([CASE], FEW, tmp_path / name, say=lambda line: None) for name in "ab")
    for method in FEW:
        for score in (one[method]["synthetic"], two[method]["synthetic"]):
            del score["seconds"], score["memory_mib"]
    assert one == two


def test_an_entry_scores_as_the_baseline_that_wrote_it(tmp_path, made):
    from matcam import write_merl

    scores = run.scores([CASE], FEW, tmp_path, say=lambda line: None)
    (tmp_path / "entry").mkdir()
    write_merl(tmp_path / "entry" / "synthetic.binary", brdf_table(table().recorded, "centre"))
    (tmp_path / "entry" / "entry.json").write_text('{"name": "mine", "seconds": {"synthetic": 2}}')
    entry = entries.find(tmp_path / "entry", ["synthetic"])
    found = run.entry_scores(entry, [CASE], tmp_path)["synthetic"]
    assert (found["seconds"], found["memory_mib"]) == (2, None)
    for mine, row in zip(found["rows"], scores["do nothing"]["synthetic"]["rows"], strict=True):
        assert mine["rms"] == pytest.approx(row["rms"], rel=1e-6, abs=1e-12)


def test_the_command_scores_an_entry(tmp_path, made, monkeypatch, capsys):
    from matcam import write_merl

    monkeypatch.setattr(command.cases, "PUBLIC", (CASE,))
    monkeypatch.setattr(command, "RESULTS", tmp_path / "none.json")
    (tmp_path / "entry").mkdir()
    write_merl(tmp_path / "entry" / "synthetic.binary", brdf_table(table().true, "centre"))
    assert command.main(["score", str(tmp_path / "entry"), "-o", str(tmp_path / "out")]) == 0
    assert "0 of 1" in capsys.readouterr().out
    document = json.loads((tmp_path / "out" / "scores.json").read_text())
    assert max(row["rms"] for row in document["entry"]["synthetic"]["rows"]) < 1e-6
    text = (tmp_path / "out" / "page.html").read_text()
    assert text.count("<svg") == 1
    assert "recovered / true peak" in text
    assert not re.search(r"(?:src|href)=\"http", text)


def test_the_figure_names_its_axes_with_units(tmp_path, made):
    scores = run.scores([CASE], FEW, tmp_path, say=lambda line: None)
    left, right = page.figure("synthetic", scores, "").axes
    assert left.get_xlabel() == "θ_d (degrees)"
    assert left.get_ylabel() == "recovered / true peak (1)"
    assert len(left.get_lines()) == len(FEW) + 1
    assert right.get_yscale() == "log"


def test_the_memory_of_a_call_is_measured():
    """In a process of its own: one that has freed memory takes no more of it."""
    script = "; ".join(
        [
            "import numpy as np",
            "from benchmarks.recovery.run import measured",
            "before = measured(lambda: 0)[2]",
            "result, seconds, memory = measured(lambda: np.ones(40_000_000).sum())",
            "print(result == 40_000_000, seconds > 0, memory > before + 200)",
        ]
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=generate.ROOT, check=True)
    assert done.stdout == "True True True\n"


def test_numbers_are_rounded_and_nothing_is_infinite():
    assert run.rounded({"a": [1 / 3, np.inf, np.float64(2)], "b": "text"}) == {
        "a": [0.33333333, None, 2.0],
        "b": "text",
    }


def test_blocks_are_replaced_between_their_marks():
    text = "a\n<!-- x -->\nold\n<!-- end of x -->\nb\n"
    assert page.with_blocks(text, {"x": ["new"]}) == "a\n<!-- x -->\nnew\n<!-- end of x -->\nb\n"
    with pytest.raises(ValueError, match="no marks of the block y"):
        page.with_blocks(text, {"y": []})


def invented(names):
    """Scores of three methods in some cases: the package is best, and within its error of the best, in turn."""

    def score(rms, predicted):
        rows = [{"quantity": "peak", "theta_d": band, "rms": rms, "predicted": predicted} for band in scoring.BANDS]
        covered = {"peak": {"entries": 100, "within 1": 0.7, "within 2": 0.95}}
        return {
            "rows": rows, "coverage": covered if predicted else {}, "harm": 0.0, "supported peaks": None, "false support": None,
            "seconds": 1.0, "memory_mib": 100,
        }  # fmt: skip

    return {
        "do nothing": {name: score(0.4, None) for name in names},
        "Wiener": {name: score(0.2, None) for name in names},
        run.OWN: {name: score(0.21 if n % 2 else 0.1, 0.05) for n, name in enumerate(names)},
    }


def test_the_page_of_all_cases_gives_the_counts():
    scores = invented([case.name for case in cases.PUBLIC])
    found = {name: "\n".join(lines) for name, lines in page.blocks(scores).items()}
    assert "| rows in which no baseline has a smaller error | - | 36 of 72 |" in found["verdict"]
    assert "| ≥ 95 % | 72 of 72 (100.0 %) |" in found["verdict"]
    assert "Incomplete" not in found["verdict"]
    assert found["beaten"].count("(Wiener) | yes |") == 36
    assert "| peak | 60-80 | 40 % | 20 % | **16 %** |" in found["errors"]
    text = " ".join(page.readme(scores))
    assert "40 % as recorded, 20 % by the best baseline (Wiener)" in text
    assert "in 72 of 72 rows. It harms 0 of 24 tables." in text


def test_an_incomplete_result_file_is_called_so():
    scores = invented(["coma", "disc"])
    assert page.verdict(scores)[0].startswith("**Incomplete**: the result file holds 2 of 24 cases.")
    assert "%" not in " ".join(page.readme(scores))


def test_rivals_do_not_contain_the_package():
    assert page.rivals(dict.fromkeys(run.METHODS)) == list(run.METHODS[:-2])
    assert set(summary.QUANTITIES) == {"peak", "slope", "tail", "F"}
