"""Whole captures drawn at random, from photographs to the material (`captures.py` runs more of them)."""

import pytest

from tests.reconstruction.captures import judged

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("number", [1, 4, 6, 11])
def test_a_capture_drawn_at_random(number):
    """Gold of roughness 0.017 and of 0.001, chromium with a Gaussian lobe, glass of roughness 0.004 over a diffuse part."""
    found = judged(number)
    assert found["fitted"] == found["family"]
    assert found["pictures"] == 18
    assert max(abs(error) for error, _ in found["ratio"]) < 0.015
    assert max(abs(error) / std for error, std in found["ratio"]) < 3
    error, std = found["roughness"]
    assert abs(error) < max(3 * std, 0.003)
    assert found["lamps_deg"] < 0.15
    assert max(map(abs, found["outline_px"])) < 0.05
    assert found["supported"] > 0
    assert found["false"] < 0.01 * found["supported"]
    assert max(map(abs, found["peaks"])) < 0.05
    assert not {code for code in found["remarks"] if code.endswith("-contradicted")}
