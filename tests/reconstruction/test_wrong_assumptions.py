"""What is stated wrongly of a capture: it is fitted, or flagged by name, or the result lies inside its errors.

Chromium, alpha = 0.02, 8 lamps, a grey sensor, drawn by the independent renderer.
"""

import numpy as np
import pytest

from matcam.reconstruction.from_capture import reconstruct
from tests.oracle.capture import METALS, Faults, Sensor, draw
from tests.oracle.sphere_picture import Surface, View, fresnel

VIEW = View(radius=300.0, column=340.0, row=340.0, shape=(681, 681))
N, K = METALS["Cr"][0][1], METALS["Cr"][1][1]
THETA_D = np.radians(np.linspace(8, 80, 8))
AZIMUTH = np.radians([20, 100, 200, 300, 45, 150, 250, 340])
ALPHA = 0.02

pytestmark = pytest.mark.slow


def drawn(view=VIEW, faults=None, seed=1):
    surface = Surface("ggx", ALPHA, n=(N,), k=(K,))
    return draw(surface, view, THETA_D, azimuth=AZIMUTH, sensor=Sensor(cfa=None), faults=faults, exposures=4, seed=seed)


def found(capture, folder, rig_from=None):
    capture.write(folder)
    result = reconstruct(folder, "ggx", rig_from=rig_from)
    return result, {remark.code for remark in result.remarks}


def lamp_errors(result, capture):
    """Angle between each lamp and the truth over its standard deviation along one tangent, and the rms angle, degrees."""
    truth = {one["lamp"]: one["direction"] for one in capture.truth["lamps"]}
    off = np.degrees(
        [np.arccos(min(truth[name] @ at, 1.0)) for name, at in zip(result.fit.names, result.fit.lamps, strict=True)]
    )
    return off / [one["std_deg"] for one in result.geometry["lamps"]], np.sqrt(np.mean(off**2))


def ratio_pull(result):
    """Error of F(75 degrees) over its mean from 10 to 45, in its standard deviations, and relative."""
    seen = result.measured_range
    normal = [a for a in np.radians(range(10, 50, 5)) if seen[0] <= a <= seen[1]]
    truth = fresnel(np.cos(np.radians(75)), N, K) / np.mean(fresnel(np.cos(normal), N, K))
    ratio = result.ratio(np.radians(75))
    return (ratio.value - truth) / ratio.std, ratio.value / truth - 1


def is_right(result, capture):
    pulls, rms = lamp_errors(result, capture)
    pull, error = ratio_pull(result)
    assert abs(pull) < 3
    assert abs(error) < 0.01
    assert pulls.max() < 5
    assert rms < 0.15


def restated(capture, change):
    """Write another angle and azimuth, both in degrees, into the lamp table."""
    for row in capture.rows:
        if row["lamp"]:
            row["angle_deg"], row["azimuth_deg"] = map(str, change(float(row["angle_deg"]), float(row["azimuth_deg"])))
    return capture


@pytest.mark.parametrize(
    ("mistake", "change"),
    [
        ("y-flipped", lambda angle, azimuth: (angle, -azimuth)),
        ("normals", lambda angle, azimuth: (angle / 2, azimuth)),
        ("radians-as-degrees", lambda angle, azimuth: (np.radians(angle), np.radians(azimuth))),
    ],
)
def test_a_mistake_in_the_lamp_table_is_named_and_does_no_harm(tmp_path, mistake, change):
    capture = restated(drawn(), change)
    result, codes = found(capture, tmp_path)
    assert f"table-{mistake}" in codes
    is_right(result, capture)


@pytest.mark.parametrize("degrees", [2, 8])
def test_a_lamp_table_that_is_wrong_by_degrees(tmp_path, degrees):
    """0.3 degrees are stated."""
    capture = drawn(faults=Faults(table=np.radians(degrees)))
    result, codes = found(capture, tmp_path)
    assert codes & {"lamp-contradicted", "table-contradicts"}
    is_right(result, capture)


def test_an_outline_that_is_small_by_a_pixel_and_a_half(tmp_path):
    capture = drawn(faults=Faults(outline=-1.5))
    result, codes = found(capture, tmp_path)
    assert "outline-contradicted" in codes
    is_right(result, capture)


def test_a_lamp_that_is_stated_as_distant(tmp_path):
    """1000 +- 10 radii are stated, it is at 20."""
    capture = drawn(VIEW._replace(lamp=20.0))
    capture.settings["distances"]["lamp_mm"] = [25000.0, 250.0]
    result, codes = found(capture, tmp_path)
    assert "lamp-distance-contradicted" in codes
    is_right(result, capture)


def test_a_lamp_whose_distance_is_not_stated(tmp_path):
    capture = drawn(VIEW._replace(lamp=20.0))
    del capture.settings["distances"]["lamp_mm"]
    result, codes = found(capture, tmp_path)
    assert "lamp-distance-not-stated" in codes
    is_right(result, capture)


@pytest.mark.parametrize("k1", [0.001, -0.01, 0.01])
def test_distortion_that_the_profile_states(tmp_path, k1):
    capture = drawn(VIEW._replace(k1=k1))
    state_field(capture, k1)
    result, _ = found(capture, tmp_path)
    is_right(result, capture)


@pytest.mark.parametrize("k1", [0.001, -0.001])
def test_distortion_that_is_left_out(tmp_path, k1):
    """0.1 %, of which no profile says anything: the errors know of it."""
    capture = drawn(VIEW._replace(k1=k1))
    result, _ = found(capture, tmp_path)
    is_right(result, capture)
    assert abs(ratio_pull(result)[0]) < 2.5  # twice what is reckoned with
    assert 0 < result.budget["distortion"]["ratio"] < result.budget["total"]["ratio"]


def test_distortion_that_a_profile_states_as_unknown_is_fitted(tmp_path):
    """0.1 % at the limb, stated as 0 +- 0.2 %."""
    capture = drawn(VIEW._replace(k1=0.001))
    state_field(capture, 0.0)
    capture.profile["field"]["k1"] = [0.0, 0.002]
    result, _ = found(capture, tmp_path)
    is_right(result, capture)
    k1, std = result.geometry["field"]["k1"]
    assert abs(k1 - 0.001) < 3 * std
    assert std < 0.0005


def state_field(capture, k1, growth=0.0):
    capture.profile["version"] = 3
    capture.profile["field"] = {
        "centre_px": [VIEW.column, VIEW.row], "unit_px": VIEW.radius, "k1": [k1, abs(k1) / 20], "k2": [0.0, 0.0],
        "growth": [growth, growth / 10], "holds_at_px": 0.0,
    }  # fmt: skip


def test_blur_that_grows_over_the_field(tmp_path):
    """20 % wider at the limb than in the middle."""
    capture = drawn(VIEW._replace(growth=0.2))
    state_field(capture, 0.0, 0.2)
    result, _ = found(capture, tmp_path)
    is_right(result, capture)


def test_a_rig_is_used_again(tmp_path):
    """Lamps that the second capture's table puts 5 degrees away, and no distances: the first one's rig has them."""
    first = drawn(seed=1)
    result, _ = found(first, tmp_path / "first")
    rig = tmp_path / "first.json"
    from matcam.core.io import write_json

    write_json(rig, result.to_dict())
    second = drawn(seed=2)
    second.settings["distances"] = {}
    restated(second, lambda angle, azimuth: (max(angle - 5, 0.0), azimuth))
    again, codes = found(second, tmp_path / "second", rig_from=rig)
    assert not {code for code in codes if "contradict" in code or "lamp" in code}
    is_right(again, second)
    assert again.geometry["lamp_radii"][1] <= 1.05 * result.geometry["lamp_radii"][1]


def test_a_diffuse_part_that_is_not_lambertian(tmp_path):
    """A glossy dielectric whose light enters and leaves its body through a smooth coat; no distance is stated."""
    surface = Surface("ggx", ALPHA, n=(1.5,), k=(0.0,), diffuse=(0.4,), coat=1.5)
    capture = draw(surface, VIEW, THETA_D, azimuth=AZIMUTH, sensor=Sensor(cfa=None), exposures=4, seed=1)
    capture.settings.pop("distances")
    result, codes = found(capture, tmp_path)
    assert "diffuse-not-lambertian" in codes
    pulls, rms = lamp_errors(result, capture)
    seen, theta = result.measured_range, np.radians(range(10, 50, 5))
    normal = theta[(theta >= seen[0]) & (theta <= seen[1])]
    truth = fresnel(np.cos(np.radians(75)), 1.5, 0.0) / np.mean(fresnel(np.cos(normal), 1.5, 0.0))
    ratio = result.ratio(np.radians(75))
    near = dict(zip(("camera", "lamp"), result.fit.solution.p[result.fit.layout.scene][2:], strict=True))
    std = np.sqrt(np.diag(result.fit.solution.covariance)[result.fit.layout.scene][2:])
    print(f"lamps {rms:.3f} degrees, F(75) {ratio.value / truth - 1:.2%} at {ratio.std / truth:.2%}, {near} +- {std}")
    assert abs(ratio.value - truth) < 3 * ratio.std
    assert abs(ratio.value / truth - 1) < 0.015
    assert rms < 0.15
    assert pulls.max() < 5
    assert abs(near["camera"] - 1 / VIEW.camera) < 3 * std[0]
    assert abs(near["lamp"] - 1 / VIEW.lamp) < 3 * std[1]
