"""Rounds of a joint fit: what is announced, and where they end; and what a stated radius means for both distances."""

import re

import numpy as np

from matcam import Camera, GaussianOptics
from matcam.files.capture_settings import Stated
from matcam.reconstruction.contradiction import with_wider
from matcam.reconstruction.joint.joint_problem import JointLayout
from matcam.reconstruction.joint.rounds import is_stuck, round_line
from matcam.reconstruction.picture_model import lamp_frame
from matcam.reconstruction.sphere_scene import SphereScene, prior_of


def test_progress_states_round_pictures_and_the_time_left():
    assert round_line([], 4, 12, 0.0) == "round 1 of at most 4, 12 images"
    limit = r"at most \d+ s left for this explanation; others may follow"
    assert re.fullmatch(
        rf"round 2 of at most 4, 12 images, 21\.0% unexplained so far, {limit}", round_line([0.21], 4, 12, 3.0)
    )


def test_rounds_end_where_much_is_unexplained_and_more_from_round_to_round():
    assert is_stuck([0.206, 0.291])
    assert is_stuck([0.2, 0.1, 0.15])
    assert is_stuck([1.0, 1.0])
    assert not is_stuck([1.0, 0.7])
    assert not is_stuck([1.0])
    assert not is_stuck([0.206])
    assert not is_stuck([0.2, 0.15])
    assert not is_stuck([0.2, 0.201])
    assert not is_stuck([0.02, 0.04])  # windows that are laid anew hold other pixels


LAYOUT = JointLayout(1, 1, 2)
SCENE = SphereScene(
    camera=Camera(GaussianOptics(0.5)),
    lens_std=0.03,
    centres=np.full((2, 2), 50.0),
    radius=40.0,
    outline_covariance=0.01 * np.eye(3),
    shift_std=0.3,
    camera_nearness=Stated(0.1, 1e-4),
    lamp_nearness=Stated(0.2, 1e-4),
    lamps=np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]]),
    lamp_std=0.01,
    sample_radius=Stated(25.0, 0.025),
)


def away(scene, p):
    """Sum of squared residuals of what is stated of the distances and the radius."""
    rows, values, sources = prior_of(LAYOUT, scene, [lamp_frame(lamp) for lamp in scene.lamps], 0.0, 0)
    mine = [source in ("camera distance", "lamp distance", "sample radius") for source in sources]
    return float(np.sum((rows[mine] @ p - values[mine]) ** 2)), sources


def test_a_wrong_radius_moves_both_distances_alike():
    """2 % in both nearnesses is 20 standard deviations of the radius, once; without it 20 and 40 of two distances."""
    p = np.zeros(LAYOUT.size)
    p[LAYOUT.scene] = [0.0, 40.0, 0.1 * 1.02, 0.2 * 1.02]
    p[LAYOUT.sample_radius] = 0.02
    found, sources = away(SCENE, p)
    assert sources.count("sample radius") == 1
    assert abs(found / 20**2 - 1) < 1e-9
    freed, _ = away(with_wider(SCENE, "sample radius", 1e3), p)
    assert freed < 1e-3
    p[LAYOUT.sample_radius] = 0.0
    blamed, _ = away(SCENE, p)
    assert abs(blamed / (20**2 + 40**2) - 1) < 1e-9


def test_a_rotated_lamp_table_is_likelier_than_two_separate_errors():
    """Lamps in the plane of x and z; own and common errors of 0.01 rad: variances 2e-4, covariance 1e-4 in this plane."""
    frames = [lamp_frame(lamp) for lamp in SCENE.lamps]
    rows, values, sources = prior_of(LAYOUT, SCENE, frames, 0.0, 0)
    mine = np.array([source == "lamp" for source in sources])

    def chi2(*angles):
        p = np.zeros(LAYOUT.size)
        for i, (frame, angle) in enumerate(zip(frames, angles, strict=True)):
            moved = np.cos(angle) * frame.base + np.sin(angle) * np.cross([0.0, 1.0, 0.0], frame.base)
            p[LAYOUT.turn(i)] = [moved @ t / (moved @ frame.base) for t in (frame.first, frame.second)]
        return float(np.sum((rows[mine] @ p - values[mine]) ** 2))

    assert mine.sum() == 4
    in_stds = (np.tan(0.02) / 0.01) ** 2
    assert abs(chi2(0.02, 0.02) / in_stds - 2 / 3) < 1e-9
    assert abs(chi2(0.02, -0.02) / in_stds - 2) < 1e-9
