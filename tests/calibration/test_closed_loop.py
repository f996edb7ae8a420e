"""The closed loop: a chart that the package draws, photographed by a camera that shares nothing with it, and calibrated."""

import json

import numpy as np
import pytest

from matcam import calibrate
from matcam.calibration.chart.chart_file import write_chart
from matcam.calibration.chart.chart_layout import design_chart
from matcam.files.photographs import Photograph
from matcam.files.picture_header import Exif
from tests.oracle.chart_camera import ChartCamera

WIDTH, HEIGHT = 560, 420


@pytest.fixture(scope="module")
def chart(tmp_path_factory):
    """Six squares: 24 edges, of which refusals leave some 20 in red and blue."""
    path = tmp_path_factory.mktemp("chart") / "chart.json"
    write_chart(path, design_chart(("squares",), page=(300.0, 225.0), pixels_across=WIDTH))
    return json.loads(path.read_text())


def photographs(chart, count, cfa, roll, snr=60):
    """Pictures by as many cameras, each in another pose: (photograph, sigma, half width)."""
    rng = np.random.default_rng(1)
    for seed in range(count):
        sigma, fill = rng.uniform(0.4, 1.0), rng.uniform(0.6, 1.0)
        camera = ChartCamera(
            WIDTH, HEIGHT, tuple(chart["page_mm"]), filled=0.93, tilt=tuple(rng.uniform(-0.12, 0.12, 2)),
            roll=rng.uniform(-roll, roll), distortion=0.02, vignetting=0.3, sigma=sigma, fill=fill,
        )  # fmt: skip
        picture = camera.photograph(camera.expected(chart), snr, seed, cfa)
        yield Photograph(picture, cfa, np.inf, True, Exif()), sigma, fill / 2


def errors(chart, count, cfa, roll):
    """Relative errors of sigma and pulls, (pictures, channels), and the fewest edges."""
    relative, pulls, edges = [], [], []
    for photograph, sigma, half_width in photographs(chart, count, cfa, roll):
        found = calibrate([photograph], half_width=half_width).channels
        value, std = (np.array([getattr(fit, name)[0] for fit in found.values()]) for name in ("values", "std"))
        relative.append(value / sigma - 1)
        pulls.append((value - sigma) / std)
        edges.append([fit.edges.x.size for fit in found.values()])
    return np.array(relative), np.array(pulls), np.array(edges)


@pytest.mark.slow
def test_sigma_of_a_grey_camera(chart):
    relative, pulls, edges = errors(chart, 4, None, 0.01)
    assert edges.min() >= 24
    assert np.sqrt((relative**2).mean()) < 0.01
    assert np.abs(pulls).max() < 4
    assert np.sqrt((pulls**2).mean()) < 1.9  # of 4: 0.6 % chance


@pytest.mark.slow
def test_sigma_of_a_bayer_camera_at_length(chart):
    relative, pulls, edges = errors(chart, 200, "RGGB", 0.06)
    inside = (np.abs(pulls) < 2).mean(0)
    print(
        "edges", np.median(edges, 0), "rms", np.sqrt((relative**2).mean(0)), "bias", relative.mean(0), "inside", inside
    )
    assert np.sqrt((relative**2).mean(0)).max() <= 0.02
    assert inside.mean() >= 0.93


@pytest.mark.slow
def test_edges_and_a_star_of_one_picture_are_one_camera(tmp_path):
    write_chart(tmp_path / "chart.json", design_chart(("squares", "star"), page=(300.0, 210.0), pixels_across=800))
    drawn = json.loads((tmp_path / "chart.json").read_text())
    camera = ChartCamera(
        800, 560, tuple(drawn["page_mm"]), filled=0.95, tilt=(0.05, -0.04), roll=0.01, sigma=0.55, fill=0.9
    )
    picture = camera.photograph(camera.expected(drawn), 60, 1, None)
    fit = calibrate([picture], chart=tmp_path / "chart.json", half_width=0.45).channels["grey"]
    assert abs(fit.values[0] - 0.55) < 4 * fit.std[0] < 0.005
    assert [kind.split("(")[1] for kind in fit.measurements] == ["edges)", "star)"]
