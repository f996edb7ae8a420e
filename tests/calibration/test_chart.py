"""Charts: their description survives its file, contradictions are refused, and the page shows what the description says."""

import json

import numpy as np
import pytest

from matcam.calibration.chart.chart import Chart, Dots, Grating, Square, Star
from matcam.calibration.chart.chart_file import chart_schema, read_chart, write_chart
from matcam.calibration.chart.chart_layout import KINDS, design_chart
from matcam.core.errors import ArgumentError, FileFormatError
from matcam.figures.chart import chart_figure
from matcam.figures.style import save
from tests.conftest import REPOSITORY


@pytest.mark.parametrize("kinds", [KINDS, ("star",), ("squares", "bars", "star", "dots")])
def test_description_survives_its_file(tmp_path, kinds):
    chart = design_chart(kinds, pixels_across=4000)
    write_chart(tmp_path / "chart.json", chart)
    assert read_chart(tmp_path / "chart.json") == chart


DEFAULT = ("squares", "bars", "star", "dots")


@pytest.mark.parametrize(
    ("kinds", "pixels"), [(KINDS, 4000), *((DEFAULT, n) for n in (400, 450, 520, 700, 3000, 6000))]
)
def test_everything_lies_on_the_page_and_nothing_on_something_else(kinds, pixels):
    chart = design_chart(kinds, pixels_across=pixels)
    seen = {type(element) for element in chart.elements}
    assert {Square, Grating, Star, Dots} <= seen
    boxes = []
    for element in chart.elements:
        if isinstance(element, Star):
            points = np.array([element.centre]) + element.outer * np.array([[-1, -1], [1, 1]])
        elif isinstance(element, Dots):
            points = np.array(element.centres)
        else:
            points = np.array(element.corners)
        boxes.append((points.min(0), points.max(0)))
    for mark in chart.fiducials:
        reach = (2 * mark.rings + 1) * mark.radius
        boxes.append((np.array(mark.centre) - reach, np.array(mark.centre) + reach))
    low, high = (np.array(side) for side in zip(*boxes, strict=True))
    assert (low > 0).all()
    assert (high < chart.page).all()
    apart = ((low[:, None] >= high[None]) | (low[None] >= high[:, None])).any(-1)
    assert (apart | np.eye(len(low), dtype=bool)).all()


@pytest.mark.parametrize("pixels", [400, 450, 500])
def test_squares_and_gratings_of_small_pages_shrink(pixels):
    chart = design_chart(pixels_across=pixels)
    pixel = chart.page[0] / pixels
    squares = [e for e in chart.elements if isinstance(e, Square)]
    gratings = [e for e in chart.elements if isinstance(e, Grating)]
    assert len(squares) == len(gratings) == 2
    assert all(40 <= np.hypot(*np.subtract(*e.corners[:2])) / pixel < 80 for e in squares)
    # a single frequency: one at which blur shows
    assert all(0.15 < pixel / e.period < 0.3 for e in gratings)


BAD = [
    ({"kinds": ["sky"]}, "kinds must be one of"),
    ({"kinds": []}, "at least one panel"),
    ({"kinds": ["star", "star"]}, "without repetition"),
    ({"page": (20, 300)}, "page must lie in [50, 5000] mm"),
    ({"page": "a9"}, "page must be one of"),
    ({"pixels_across": 100}, "pixels_across must lie in"),
    ({"pixels_across": 300, "kinds": KINDS}, "or pixels_across above"),
    ({"pixels_across": 100_000, "kinds": ["dots"], "page": "a3"}, "at most 200,000"),
]


@pytest.mark.parametrize(("arguments", "words"), BAD)
def test_designs_that_cannot_be(arguments, words):
    with pytest.raises(ArgumentError) as error:
        design_chart(**arguments)
    assert words in str(error.value)


DAMAGE = [
    (lambda d: d.update(version=9), "chart version 9 is unknown"),
    (lambda d: d.update(format="x"), 'field "format"'),
    (lambda d: d["elements"][0].update(colour="red"), "field elements.0"),
    (lambda d: d["elements"][-1].update(pitch_mm=1e-3), "2 radius < pitch"),
    (lambda d: d["elements"][-2].update(cycles=3), "cycles"),
    (lambda d: d["elements"][-2].update(dark=0.99), "dark must lie below bright"),
    (lambda d: d["fiducials"].pop(0), "exactly one mark with 2 rings"),
    (lambda d: d["page_mm"].pop(), "field page_mm"),
]


@pytest.mark.parametrize("number", range(len(DAMAGE)))
def test_damaged_descriptions(tmp_path, number):
    path = tmp_path / "chart.json"
    write_chart(path, design_chart())
    document = json.loads(path.read_text())
    damage, words = DAMAGE[number]
    damage(document)
    path.write_text(json.dumps(document))
    with pytest.raises(FileFormatError) as error:
        read_chart(path)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_harmonics_of_printed_patterns():
    t = (np.arange(20_000) + 0.5) / 20_000
    for profile, duty in (("bars", 0.5), ("lines", 0.25), ("sine", 0.5)):
        grating = Grating(profile, (0, 0), (1, 1), 0.0, 1.0, 0.0, 0.2, 0.9, duty)
        wave = np.cos(2 * np.pi * t) if profile == "sine" else np.where(np.abs(t - np.round(t)) < duty / 2, 1.0, -1.0)
        level = 0.55 + 0.35 * wave
        for order in (1, 2, 3, 5):
            truth = 2 * (level * np.cos(2 * np.pi * order * t)).mean() / level.mean()
            assert grating.harmonic(order) == pytest.approx(truth, abs=1e-7)


def test_published_schema_is_the_one_in_the_code():
    assert json.loads((REPOSITORY / "docs" / "chart-v1.schema.json").read_text()) == chart_schema()


def _decoded(page):
    """Linear levels of a PNG."""
    import imagecodecs

    code = imagecodecs.png_decode(page.read_bytes())[..., 0] / 255
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)


def test_page_shows_what_its_description_says(tmp_path):
    dpi = 600
    star = Star((20, 20), 4, 14, 36, 0.7, 0.25, 0.95)
    sine = Grating("sine", (52, 12), (16, 10), 0.3, 2.0, 0.4, 0.25, 0.95)
    bars = Grating("bars", (52, 36), (16, 10), 0.3, 2.0, 0.4, 0.25, 1.0)
    square = Square(((70, 10), (80, 11), (79, 21), (69, 20)), 0.3)
    dots = Dots(((74, 40), (78, 40)), 0.8, 4.0, 0.05)
    chart = Chart((91.44, 60.96), (), (star, sine, bars, square, dots), 0.05)
    save(chart_figure(chart), tmp_path / "page.png", dpi=dpi)
    level = _decoded(tmp_path / "page.png")
    assert level.shape == (1440, 2160)
    y, x = ((np.arange(n) + 0.5) * side / n for n, side in zip(level.shape, (60.96, 91.44), strict=True))
    x, y = np.meshgrid(x, y)

    def amplitude(part, phase):
        """Complex first harmonic, and mean."""
        design = np.stack([np.ones(part.sum()), np.cos(phase[part]), np.sin(phase[part])], axis=-1)
        return np.linalg.lstsq(design, level[part], rcond=None)[0]

    radius = np.hypot(x - 20, y - 20)
    found = amplitude((radius > 5) & (radius < 13.5), 36 * np.arctan2(y - 20, x - 20) + 0.7)
    # pixels that polygons share are averaged in codes, not in levels: 4e-3 at 600 dpi, 1e-3 at 2400
    np.testing.assert_allclose(found, [0.6, 0.35, 0], atol=3e-3)
    for grating, expected in ((sine, [0.6, 0.35, 0]), (bars, [0.625, 0.375 * 4 / np.pi, 0])):
        u = (x - grating.centre[0]) * np.cos(0.3) + (y - grating.centre[1]) * np.sin(0.3)
        v = (y - grating.centre[1]) * np.cos(0.3) - (x - grating.centre[0]) * np.sin(0.3)
        # whole periods
        found = amplitude((np.abs(u) < 6) & (np.abs(v) < 4.5), np.pi * u + 0.4)
        np.testing.assert_allclose(found, expected, atol=3e-3)
    assert abs(level[(np.hypot(x - 74.5, y - 15.5) < 3)] - 0.3).max() < 0.003
    dot = (np.abs(x - 74) < 1.5) & (np.abs(y - 40) < 1.5)
    # where a pixel is cut by an edge, codes and not levels were averaged
    assert (1 - level[dot]).sum() * (25.4 / dpi) ** 2 == pytest.approx(0.95 * np.pi * 0.8**2, rel=0.02)
