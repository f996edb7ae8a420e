"""The page on all stand-ins says what its result file says, and the file holds what was asked."""

import importlib.util
import sys
from pathlib import Path

import pytest

from matcam.core.readers.texts import read_json

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("stand_ins", ROOT / "benchmarks" / "stand_ins.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


@pytest.fixture(scope="module")
def results():
    return read_json(ROOT / "benchmarks" / "stand_ins.json", "results")


def test_the_page_is_that_of_its_results(script, results):
    page = (ROOT / "docs" / "stand-ins.md").read_text(encoding="utf-8")
    assert script.with_results(page, results) == page, "make it anew: python benchmarks/stand_ins.py page"
    for name in results:
        assert page.count(f"| {name} |") == 1


def test_no_stand_in_was_harmed(script, results):
    assert all("error" not in one for one in results.values())
    for name, one in results.items():
        assert one["largest_change_unsupported"] == 0, name
        assert one["albedo"]["file"] <= max(1.0, one["albedo"]["recorded"]) + 1e-9, name
        assert one["peaks_raised_beyond_2_std"] == 0, name
    assert script.median_noise(results) < 0.05


def test_the_figure_names_its_axes_with_units(script, results):
    (axes,) = script.figure(results).axes
    assert "(degrees)" in axes.get_xlabel()
    assert "(%)" in axes.get_ylabel()
