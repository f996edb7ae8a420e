"""What a capture states of its camera, where that is missing or wrong."""

import numpy as np
import pytest

from matcam.acquisition.radiometry import measure_radiometry
from matcam.files.capture import read_capture
from matcam.reconstruction.stated.captured_scene import INCOMPLETE
from matcam.reconstruction.stated.stated_rig import captured_lens
from tests.acquisition.drawn import VIEW, changed, surface
from tests.oracle.capture import Sensor, draw


@pytest.mark.parametrize(
    ("profile", "cfa", "words"),
    [
        (None, "RGGB", "no such file"),
        ("{}", "RGGB", "not a camera profile"),
        ("", "BGGR", "is of a camera with the mosaic"),
    ],
)
def test_a_profile_that_cannot_be_used_is_left_out_and_named(tmp_path, profile, cfa, words):
    """The lens is fitted from a guess, and the gain, which one exposure does not determine, from the frames."""
    drawn = draw(surface(), VIEW, np.radians([10, 35]), exposures=1, seed=4, reference=None, sensor=Sensor())
    settings = {**drawn.settings, "camera": {**drawn.settings["camera"], "cfa": cfa}}
    folder = changed(drawn, settings=settings).write(tmp_path)
    if profile is None:
        (folder / "camera.json").unlink()
    elif profile:
        (folder / "camera.json").write_text(profile)
    capture, remarks = read_capture(folder), []
    camera, std = captured_lens(capture, remarks)
    assert float(camera.optics.sigma) == 0.5
    assert std == pytest.approx(0.7)
    assert [one.code for one in remarks] == ["profile-left-out"]
    assert words in remarks[0].text
    assert remarks[0].code in INCOMPLETE
    assert "gain-stated" not in {one.code for one in measure_radiometry(capture).remarks}
