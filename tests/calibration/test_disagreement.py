"""The stated standard deviation of a blur follows from targets and edges that contradict it, not from noise alone."""

import json

import numpy as np
import pytest

from matcam import calibrate
from matcam.calibration import MeanCurve
from matcam.calibration.camera.disagreement import blur_disagreement
from matcam.calibration.chart.chart_file import write_chart
from matcam.calibration.chart.chart_layout import design_chart
from tests.oracle.chart_camera import ChartCamera

SIGMA = 0.6
FREQUENCY = np.linspace(0, 0.5, 6)


@pytest.fixture(scope="module")
def photographed(tmp_path_factory):
    """Chart of edges, gratings and a star, and its photograph with linear codes of 8 bits."""
    path = tmp_path_factory.mktemp("chart") / "chart.json"
    write_chart(path, design_chart(("squares", "bars", "star"), page=(300.0, 210.0), pixels_across=800))
    chart = json.loads(path.read_text())
    camera = ChartCamera(
        800, 560, tuple(chart["page_mm"]), filled=0.95, tilt=(0.05, -0.04), roll=0.03, sigma=SIGMA, fill=1.0
    )
    light = camera.photograph(camera.expected(chart), 150, 1, None)
    return path, np.clip(np.rint(light / light.max() * 230), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("model", [pytest.param("gaussian", marks=pytest.mark.slow), "measured"])
def test_a_wrong_tone_curve_is_in_the_standard_deviation(photographed, model):
    """Edges, gratings and star disagree, because each has another contrast."""
    chart, codes = photographed
    fit = calibrate([codes], chart=chart, tone="srgb", model=model).channels["grey"]
    assert fit.values[0] < 0.96 * SIGMA
    assert abs(fit.values[0] - SIGMA) < 2 * fit.std[0]
    assert any(remark.code == "disagreement" for remark in fit.remarks)
    assert np.sqrt(np.diag(fit.camera.uncertainty.covariance)).max() > 0.02


def test_the_right_tone_curve_costs_nothing(photographed):
    chart, codes = photographed
    fit = calibrate([codes], chart=chart, tone="linear").channels["grey"]
    assert abs(fit.values[0] - SIGMA) < 4 * fit.std[0] < 0.006
    assert not fit.remarks


def test_one_damaged_target_of_many_is_no_disagreement():
    curve = MeanCurve(FREQUENCY, 1 - FREQUENCY, np.full(6, 1e-3), 1 - FREQUENCY)
    groups = ["a: (edges)", *(f"a: grating {n} (grating)" for n in range(5))]
    assert blur_disagreement(groups, {groups[1]: -0.3}, curve, -FREQUENCY) == 0
    assert blur_disagreement(groups, dict.fromkeys(groups[1:4], -0.3), curve, -FREQUENCY) == pytest.approx(0.3)


def test_a_misfit_of_the_model_is_a_change_of_the_blur():
    curve = MeanCurve(FREQUENCY, 1 - FREQUENCY, np.full(6, 1e-3), 1 - 1.1 * FREQUENCY)
    assert blur_disagreement(["a (edges)"], {}, curve, -FREQUENCY) == pytest.approx(0.1)
