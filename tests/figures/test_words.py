"""Words beside numbers: each says what its number means."""

import re

import numpy as np
import pytest

from matcam import Cylinder, Flat, Sphere
from matcam.cli import _run
from matcam.cli.fit import print_fit
from matcam.figures.curves import loss_figure
from matcam.paper import figure_5
from matcam.reconstruction.contradiction import times_off


@pytest.mark.parametrize(
    ("sample", "words"),
    [
        (Sphere(256.0), "sphere of 256 px radius"),
        (Sphere(300.0, 28.0), "sphere of 300 px radius, camera at 28 radii"),
        (Cylinder(100.0), "cylinder of 100 px radius"),
        (Flat(), "flat sample"),
    ],
)
def test_samples_in_words(sample, words):
    assert sample.in_words() == words


def test_titles_of_predictions_are_words(tmp_path):
    """No code in a title, and an axis that shows what is kept is not called a loss."""
    assert _run(["predict", "0.01", "-o", str(tmp_path / "a.svg"), "--map", str(tmp_path / "b.svg")]) == 0
    for name in ("a.svg", "b.svg"):
        written = re.findall(r"<text[^>]*>([^<]*)</text>", (tmp_path / name).read_text())
        title = next(text for text in written if "px radius" in text)
        assert title.startswith("Recorded share of the peak")
        assert not any("Sphere(" in text or "Loss" in text for text in written)


def test_the_paper_figure_shows_what_is_kept():
    assert loss_figure(figure_5()).axes[0].get_title(loc="left").startswith("Recorded over true peak")


def test_a_distance_in_standard_deviations_has_no_false_digits():
    assert times_off(2.5) == "off by about 2 times"
    assert times_off(1662.2) == "off by more than 10 times"


def test_residuals_are_no_test_of_the_model(capsys):
    """Their ratio to the noise that is estimated from them is near 1 where the model is wrong, too, and below 1 in the dark."""
    fit = {
        "params": {"alpha": 0.01}, "std": {"alpha": 1e-4}, "spline_modified": False, "ndf": "ggx", "hwhm_rad": 0.01,
        "hwhm_std_rad": 1e-4, "noise": {"relative": 0.2, "floor": 0.0, "picture_gain": 0.0}, "misfit": 0.797,
        "degrees_of_freedom": 100, "remarks": [],
    }  # fmt: skip
    print_fit(fit, "a.binary")
    printed = " ".join(capsys.readouterr().out.split())
    assert f"ratio of the residual of a cell to its expected standard deviation: {np.sqrt(0.797):.2f} rms" in printed
    assert "at least 3e-06 of the image's peak, so faint cells lower the ratio" in printed
    assert "estimated from the residuals, so the ratio is not a test of the model" in printed
