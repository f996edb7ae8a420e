"""The figures of docs/howto/photograph-a-sphere.md, computed again."""

import re
from pathlib import Path

import numpy as np
import pytest

from matcam import GGX, BoxPixel, Camera, GaussianOptics, Rig, Sphere, loss_angle, peak_response

PAGE = (Path(__file__).parents[2] / "docs" / "howto" / "photograph-a-sphere.md").read_text(encoding="utf-8")


def test_turns_of_the_line_of_sight():
    """Towards the limb of a sphere at d radii a direction turns by asin(1 / d), and the half vector by half of it."""
    assert f"turns by {np.degrees(np.arcsin(1 / 30)):.1f}° at the limb" in PAGE
    assert f"half vector off by up to {np.degrees(np.arcsin(1 / 28)) / 2:.1f}°" in PAGE
    assert np.degrees(np.arcsin(1 / 300)) / 2 < 0.1
    assert "from 300 radii on" in PAGE


def test_pixels():
    camera = Camera(GaussianOptics(0.5), BoxPixel(0.5))
    rows = re.findall(r"\| (\d+) px \| (.*) \|", PAGE)
    assert len(rows) == 3
    for radius, cells in rows:
        rig = Rig(camera, Sphere(float(radius)))
        for alpha, cell in zip((0.002, 0.005, 0.02), cells.split(" | "), strict=True):
            kept, angle = map(float, re.fullmatch(r"([\d.]+) %, ([\d.]+)°", cell).groups())
            assert kept / 100 == pytest.approx(float(peak_response(rig, GGX(alpha), 0.0)), abs=0.0051)
            assert angle == pytest.approx(np.degrees(float(loss_angle(rig, GGX(alpha)))), abs=0.51)


def test_lamp():
    """A disc of 0.25 degrees: a quarter of its radius in the half vector, rad."""
    spread = np.radians(0.25) / 4
    assert f"{1e3 * spread:.1f} mrad" in PAGE
