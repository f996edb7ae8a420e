"""A real ball (DiLiGenT, 96 photographs, no profile of the camera) through all of `reconstruct`, by what others measured."""

import csv
import shutil

import numpy as np
import pytest

from matcam import reconstruct

TOML = """format = "matcam capture"
version = 1
[camera]
accept_processed = true
black_level_dn = 0
[sample]
kind = "sphere"
[lamp]
motion = "table"
intensity = "table"
gain_std = 0.02
direction_std_deg = 0.5
"""


def capture(real_data, folder, every):
    """A folder of every so many of its pictures, and the published directions to their lamps."""
    source = real_data / "captures" / "diligent_ball"
    with (source / "lights.csv").open() as file:
        rows = list(csv.DictReader(file))[::every]
    (folder / "frames").mkdir(parents=True)
    lines, lamps = ["file,lamp,angle_deg,azimuth_deg,exposure,time_s,intensity"], []
    for row in rows:
        shutil.copy(source / row["file"], folder / "frames" / row["file"])
        x, y, z = (float(row[axis]) for axis in ("lx", "ly", "lz"))
        lamps.append(np.array([x, y, z]) / np.linalg.norm([x, y, z]))
        angle, azimuth = np.degrees([np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)])
        light = " ".join(row[f"intensity_{colour}"] for colour in "rgb")
        lines.append(f"frames/{row['file']},{row['file'][:3]},{angle:.4f},{azimuth:.4f},E1,,{light}")
    (folder / "frames.csv").write_text("\n".join(lines) + "\n")
    (folder / "capture.toml").write_text(TOML)
    return folder, np.array(lamps)


@pytest.fixture(scope="module")
def ball(real_data, tmp_path_factory):
    """Every 16th picture: what is found, and the published directions."""
    folder, lamps = capture(real_data, tmp_path_factory.mktemp("real") / "ball", 16)
    return reconstruct(folder, ndf="ggx"), lamps


@pytest.mark.slow
def test_a_real_ball_without_a_profile(ball):
    found, _ = ball
    fit = found.fit
    column, row = fit.solution.p[fit.layout.own(0)][:2]
    # in the original, by 72 radial edges: column 307.81, row 263.68
    assert (column, row) == pytest.approx((103.81, 103.68), abs=0.35)
    # without a profile the lens stays what it was guessed to be, and is not told from the lobe
    value, std = found.parameters["sigma_px"]
    assert abs(value - 0.7) < 2 * std
    assert found.not_determined[0].names[0] == "lens"
    assert "The pictures alone do not tell lens from" in found.verdict
    assert np.degrees(found.measured_range[1]) < 22.5
    codes = {remark.code for remark in found.remarks}
    assert {"processed", "lens-guessed", "not-determined"} <= codes
    assert "7 pixels are clipped" in " ".join(str(remark) for remark in found.remarks)


@pytest.mark.slow
@pytest.mark.xfail(
    reason="70.7 px, 1.0 degree: 2 % that no lobe explains, alike in neighbouring pixels, blames the outline"
)
def test_outline_and_lamps_of_a_real_ball(ball):
    fit, lamps = ball[0].fit, ball[1]
    apart = np.degrees(np.arccos(np.clip(np.sum(fit.lamps * lamps, axis=1), -1, 1)))
    radius, off = fit.solution.p[fit.layout.scene][1], np.sqrt(np.mean(apart**2))
    print(f"radius {radius:.2f} px, lamps {off:.2f} degrees rms off")
    assert radius == pytest.approx(71.13, abs=0.1)
    assert off <= 0.4
