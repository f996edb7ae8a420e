"""Exposures, lobes and pictures that are not as stated: fitted, flagged by name, or inside the stated errors.

Chromium, 8 lamps, a grey sensor and a sphere of 120 px, drawn by the independent renderer.
"""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from matcam.acquisition.capture_check import check_capture
from matcam.core.errors import FitError
from matcam.files.capture import read_capture
from matcam.reconstruction.from_capture import reconstruct
from tests.oracle.capture import METALS, Faults, Sensor, draw
from tests.oracle.sphere_picture import Surface, View, fresnel

VIEW = View(radius=120.0, column=140.3, row=139.6, shape=(281, 281))
N, K = METALS["Cr"][0][1], METALS["Cr"][1][1]
THETA_D = np.radians(np.linspace(8, 78, 8))
AZIMUTH = np.radians([20, 100, 200, 300, 45, 150, 250, 340])

pytestmark = pytest.mark.slow


def chromium(family, alpha, power=1.0):
    return Surface(family, alpha, power, n=(N,), k=(K,))


def drawn(surface, seed, **more):
    more.setdefault("faults", Faults())
    return draw(
        surface, VIEW, THETA_D, azimuth=AZIMUTH, sensor=Sensor(cfa=None), exposures=4, seed=seed, reference=None, **more
    )


def by_the_dial(capture):
    """Nominal times as a dial prints them: every second one is 6.7 % too long."""
    for row in capture.rows:
        step = int(row["exposure"][1:])
        row["time_s"] = f"{4.0**step / 1000 * (1.067 if step % 2 else 1):.8g}"
    return capture


def ratio_error(result):
    """Relative error of F(75 degrees) over its mean from 10 to 45, and the stated one."""
    seen = result.measured_range
    normal = [a for a in np.radians(range(10, 50, 5)) if seen[0] <= a <= seen[1]]
    truth = fresnel(np.cos(np.radians(75)), N, K) / np.mean(fresnel(np.cos(normal), N, K))
    ratio = result.ratio(np.radians(75))
    return ratio.value / truth - 1, ratio.std / truth


def codes(result):
    return {remark.code for remark in result.remarks}


@pytest.mark.parametrize("seed", [2, 3])
def test_exposures_as_printed_on_the_dial(tmp_path, seed):
    capture = by_the_dial(drawn(chromium("ggx", 0.02), seed, faults=Faults(exposure=0.0)))
    result = reconstruct(capture.write(tmp_path), "ggx")
    assert "times-wrong" in codes(result)
    error, std = ratio_error(result)
    assert abs(error) < 3 * std < 0.025  # a gain of 0.5 % in each of eight pictures is stated
    exposures = result.captured.radiometry.exposures
    true = {one["exposure"]: one["relative"] for one in capture.truth["exposures"]}
    unit = true[result.captured.radiometry.reference_exposure]
    assert max(abs(value.value * unit / true[name] - 1) for name, value in exposures.items()) < 3e-3


def test_one_exposure_of_each_lamp_position_by_the_dial(tmp_path):
    """Nothing links the exposures: that is said by name, and nothing is claimed."""
    capture = by_the_dial(drawn(chromium("ggx", 0.02), 1, faults=Faults(exposure=0.0), peak_fill=0.4))
    rows = []
    for row in capture.rows:
        step = int(row["exposure"][1:])
        if step == int(row["lamp"][1:]) % 2 if row["lamp"] else step < 2:
            rows.append(row)
    capture.rows = rows
    capture.frames = {row["file"]: capture.frames[row["file"]] for row in rows}
    result = reconstruct(capture.write(tmp_path), "ggx")
    assert "exposures-not-linked" in codes(result)
    error, std = ratio_error(result)
    assert abs(error) < 3 * std


@pytest.mark.parametrize(("alpha", "power", "seed"), [(0.01, 0.6, 1), (0.01, 0.6, 2), (0.02, 1.2, 3)])
def test_an_exponential_power_lobe_is_chosen_at_once(tmp_path, alpha, power, seed):
    result = reconstruct(drawn(chromium("epd", alpha, power), seed).write(tmp_path))
    # the lattice of both families tells it, and nothing else is fitted
    assert [one.name for one in result.tried] == ["epd"]
    error, std = ratio_error(result)
    assert abs(error) < 3 * std < 0.025
    for name, true in (("beta", alpha), ("power", power)):
        value, spread = result.parameters[name]
        assert abs(value - true) < max(4 * spread, 0.005 * true)


def test_two_lobes_need_a_spline_and_nothing_else_is_blamed(tmp_path):
    """Half of the light from GGX of 0.008, half from one of 0.04."""
    capture = drawn(chromium("ggx", 0.008), 1, second=(0.5, chromium("ggx", 0.04)))
    result = reconstruct(capture.write(tmp_path))
    assert "lobe-spline-modified" in codes(result)
    assert not {code for code in codes(result) if "contradict" in code}
    assert result.fit.solution.unexplained < 0.005
    error, std = ratio_error(result)
    assert abs(error) < 3 * std < 0.025


def sharpened(capture, amount):
    for name, frame in capture.frames.items():
        values = frame.astype(float)
        values += amount * (values - gaussian_filter(values, 1.0))
        capture.frames[name] = np.clip(np.round(values), 0, 2**14 - 1).astype(np.uint16)
    return capture


@pytest.mark.parametrize("amount", [0.2, 0.5])
def test_sharpened_frames_are_refused_by_name(tmp_path, amount):
    capture = sharpened(drawn(chromium("ggx", 0.02), 1), amount)
    folder = capture.write(tmp_path)
    assert "sharpened" in {finding.code for finding in check_capture(read_capture(folder)).findings}
    with pytest.raises(FitError, match="sharpened"):
        reconstruct(folder, "ggx")


def test_a_dim_diffuse_part_that_is_not_lambertian_is_no_change_of_the_light(tmp_path):
    """A glossy dielectric exposed once: noise explains each pixel of its body, but not all pixels together."""
    surface = Surface("ggx", 0.008, n=(1.5,), k=(0.0,), diffuse=(0.4,), coat=1.5)
    capture = draw(
        surface, VIEW, THETA_D, azimuth=AZIMUTH, sensor=Sensor(cfa=None), exposures=1, seed=1, reference=None, faults=Faults()
    )  # fmt: skip
    result = reconstruct(capture.write(tmp_path), "ggx")
    assert "gain-contradicted" not in codes(result)
    assert "diffuse-not-lambertian" in codes(result)
    seen = result.measured_range
    normal = [a for a in np.radians(range(10, 50, 5)) if seen[0] <= a <= seen[1]]
    truth = fresnel(np.cos(np.radians(75)), 1.5, 0.0) / np.mean(fresnel(np.cos(normal), 1.5, 0.0))
    ratio = result.ratio(np.radians(75))
    assert abs(ratio.value - truth) < 3 * ratio.std
    assert ratio.std < 0.05 * truth
