"""The unit of merged values from a white patch, judged by captures whose truth is known (tests/oracle/capture.py)."""

from functools import cache

import numpy as np
import pytest

from matcam.acquisition.light.reference_patch import ReferencePatch, patch_geometry, patch_light
from matcam.acquisition.mirror_ball import MirrorBall
from matcam.acquisition.radiometry import measure_radiometry
from matcam.files.capture import Stated, read_capture
from tests.acquisition.drawn import surface
from tests.oracle.capture import draw
from tests.oracle.sphere_picture import View

VIEW = View(radius=60.0, column=112.3, row=108.7, shape=(220, 220))
BALL = MirrorBall(VIEW.row, VIEW.column, VIEW.radius, VIEW.camera)


@cache
def drawn(seed):
    return draw(surface(), VIEW, np.radians([5, 15, 25, 35, 60]), reference="diffuse", seed=seed, exposures=4)


def light_of(capture, truth, radiometry, **changes):
    """What the patch says, with the true lamps and sphere: no fit stands between."""
    stated = capture.settings["reference"]
    patch = ReferencePatch(
        capture.reference_region,
        Stated(*stated["reflectance"]),
        Stated(*(v / 25.0 for v in stated["depth_mm"])),
        np.radians(stated["tilt_std_deg"]),
    )
    far = capture.lamp_radii
    return patch_light(
        patch._replace(**changes),
        [radiometry.reference_light[lamp["lamp"]] for lamp in truth["lamps"]],
        BALL,
        np.array([lamp["direction"] for lamp in truth["lamps"]]),
        1 / far.value,
        lamp_std=np.full(len(truth["lamps"]), 1e-4),
        gain_std=0.005,
        exposure_std=max(one.std / one.value for one in radiometry.exposures.values()),
    )


def true_units(truth, radiometry):
    relative = {one["exposure"]: one["relative"] for one in truth["exposures"]}[radiometry.reference_exposure]
    scale = truth["electrons_per_radiance"] * relative * truth["gain_dn_per_electron"] / radiometry.gain.value
    return scale * np.array(truth["sensor"]["sensitivity"])


@pytest.mark.parametrize("seed", [0, 1])
def test_a_white_patch_gives_the_unit_of_each_channel(tmp_path, seed):
    truth = drawn(seed).truth
    capture = read_capture(drawn(seed).write(tmp_path))
    radiometry = measure_radiometry(capture)
    found = light_of(capture, truth, radiometry)
    gain_std = np.sqrt(np.diag(found.covariance))
    assert (gain_std[:4] < 0.9 * gain_std[4]).all()  # lit from behind, the patch says nothing
    off = np.array([unit.value for unit in found.units]) / true_units(truth, radiometry) - 1
    std = np.array([unit.std for unit in found.units])
    assert (np.abs(off) < 3 * std).all()
    assert (std < 0.007).all()
    gains = np.log(found.gain) - np.log([lamp["gain"] for lamp in truth["lamps"]])
    away = gains - gains[:4].mean()
    assert (np.abs(away[:4]) < 4 * gain_std[:4]).all()


def test_what_is_not_known_of_the_patch_is_in_its_error(tmp_path):
    truth = drawn(0).truth
    capture = read_capture(drawn(0).write(tmp_path))
    radiometry = measure_radiometry(capture)
    std = {
        name: light_of(capture, truth, radiometry, **changes).units[1].std
        for name, changes in {
            "as stated": {},
            "reflectance": {"reflectance": Stated(0.98, 0.03)},
            "depth": {"depth": Stated(0.1, 0.5)},
            "tilt": {"tilt_std": np.radians(5)},
        }.items()
    }
    assert std["reflectance"] == pytest.approx(np.hypot(std["as stated"], 0.03), abs=1e-3)
    # half a radius is 4 % of the light of a lamp at 25 radii; how the light falls over the angles says more
    assert 1.5 * std["as stated"] < std["depth"] < 0.04
    assert std["tilt"] > 1.1 * std["as stated"]
    assert light_of(capture, truth, radiometry, reflectance=None).units is None


def test_light_on_a_patch_falls_with_distance_and_cosine():
    """Against the law itself: the lamp's place less the patch's, in one line of vectors."""
    position, far = np.array([1.4, -0.6, 0.3]), 12.0
    lamp = np.array([np.sin(0.7), 0.0, np.cos(0.7)])
    way = far * lamp - position
    normal = np.array([0.1, -0.05, 1.0]) / np.sqrt(1 + 0.1**2 + 0.05**2)
    expected = (way @ normal) / np.linalg.norm(way) ** 3 * far**2
    geometry, cosine = patch_geometry(lamp[None], 1 / far, position, (0.1, -0.05))
    assert geometry[0] == pytest.approx(expected, rel=1e-12)
    assert cosine[0] == pytest.approx((way @ normal) / np.linalg.norm(way), rel=1e-12)
