"""`matcam reconstruct` on a capture of a flat sample that an independent renderer drew."""

import json

import numpy as np
import pytest

from matcam.io import read_netcdf
from tests.oracle.capture import Sensor
from tests.oracle.flat_picture import FlatStand, draw, random_texture

TILTS = np.radians([0, 10, 20, 30, 40])
LAMPS = [(np.radians(20), 0.0)] * 5
STAND = FlatStand(shape=(128, 128))


def textures():
    rng = np.random.default_rng(1)
    return random_texture(0.4, 0.08, -2.0, 192, rng), random_texture(0.06, 0.02, -1.5, 192, rng)


def test_maps_of_a_tilted_stack(matcam, tmp_path):
    """A fixed lamp, five tilts: theta_d is the same in all, and roughness and maps come out within their errors."""
    diffuse, specular = textures()
    draw(diffuse, specular, STAND, TILTS, LAMPS, seed=2).write(tmp_path / "cloth")
    done = matcam("reconstruct", tmp_path / "cloth", "-o", "cloth.binary")
    assert done.stdout.splitlines()[-1] == "next: matcam inspect cloth.nc"
    assert {path.name for path in tmp_path.glob("cloth.*")} == {"cloth.nc", "cloth.json"}
    found = json.loads((tmp_path / "cloth.json").read_text())
    assert found["sample"] == "flat"
    value, std = found["parameters"]["alpha"]
    assert abs(value - STAND.alpha) < 4 * std
    assert not [one for one in found["remarks"] if one["code"] in ("theta-d-varies", "misfit", "roughness-loose")]
    along, across = found["cutoff_cycles_per_px"]["diffuse"]
    assert 0.25 < along <= 0.5
    assert 0.25 < across <= 0.5
    assert found["cutoff_lp_per_mm"]["diffuse"] == pytest.approx([along / 0.02, across / 0.02])
    maps = read_netcdf(tmp_path / "cloth.nc")
    for name, texture in (("diffuse", diffuse), ("specular", specular)):
        values = maps[name].values
        truth = texture.at(maps.x.values, maps.y.values)
        truth *= values.mean() / truth.mean()
        std = float(maps[f"{name}_std"][0, 0])
        assert 0.5 * std < (values - truth).std() < 1.2 * std
        assert np.corrcoef(values.ravel(), truth.ravel())[0, 1] > 0.9


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sample": {"kind": "flat", "tilt_deg": [0.0, 5.0]}}, "sample.tilt_deg has 2 angles for 5 lamp positions"),
        ({"camera": {"profile": "camera.json", "cfa": "RGGB"}}, "needs grey images, got a mosaic"),
    ],
)
def test_what_does_not_suit_a_flat_sample_is_one_line(matcam, tmp_path, change, message):
    drawn = draw(*textures(), STAND, TILTS, LAMPS, exposures=1, sensor=Sensor(cfa=None))
    drawn.settings |= change
    drawn.write(tmp_path / "cloth")
    done = matcam("reconstruct", tmp_path / "cloth", code=2)
    assert message in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(("number", "damage", "reason"), [(1, None, "no such file"), (0, b"II*\0", "")])
def test_a_frame_that_cannot_be_used_costs_no_results(matcam, tmp_path, number, damage, reason):
    """The results are written, the exit code is 1, and the frame, missing or damaged, is listed with the reason."""
    diffuse, specular = textures()
    folder = draw(diffuse, specular, STAND, TILTS, LAMPS, seed=2).write(tmp_path / "cloth")
    gone = sorted((folder / "frames").iterdir())[number]
    gone.unlink()
    if damage:
        gone.write_bytes(damage)
    done = matcam("reconstruct", folder, "-o", "cloth.binary", code=1)
    assert {path.name for path in tmp_path.glob("cloth.*")} == {"cloth.nc", "cloth.json"}
    assert f"left out: {folder / 'frames' / gone.name}: {reason}" in done.stdout
    found = json.loads((tmp_path / "cloth.json").read_text())
    assert any(gone.name in one["text"] for one in found["remarks"])
