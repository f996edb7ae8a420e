"""Exposure ratios, clip level, gain and merged noise over captures of many materials, full size (slow)."""

import json

import numpy as np
import pytest

from matcam.acquisition.merging import merge
from matcam.files.capture import read_capture
from tests.acquisition.drawn import surface
from tests.oracle.capture import Sensor, draw, noiseless
from tests.oracle.sphere_picture import View

CASES = [
    # metal, alpha, family, power, diffuse, sensor's clipping, colours
    ("Cr", 0.001, "ggx", 1.0, 0.0, "well", "RGGB"),
    ("Cr", 0.02, "ggx", 1.0, 0.0, "converter", "RGGB"),
    ("Au", 0.005, "ggx", 1.0, 0.0, "well", "RGGB"),
    ("Au", 0.1, "epd", 0.7, 0.0, "well", None),
    ("glass", 0.02, "ggx", 1.0, 0.1, "well", "RGGB"),
    ("glass", 0.001, "epd", 1.0, 0.05, "converter", "GRBG"),
    ("glass", 0.1, "ggx", 1.0, 0.3, "well", None),
    ("Cr", 0.05, "epd", 1.5, 0.0, "well", "RGGB"),
]


@pytest.mark.slow
def test_radiometry_of_full_captures(tmp_path):
    """Ratios <= 0.1 % rms, clip level <= 0.5 %, lamp output <= 0.1 % rms; merged values scatter as they say."""
    ratios, pulls, clips, gains, outputs, merged = [], [], [], [], [], []
    for seed, (name, alpha, family, power, diffuse, clip, cfa) in enumerate(CASES):
        view = View(radius=300.0, column=338.4, row=341.7, shape=(680, 680))
        material = surface(name, alpha, family, power, diffuse)
        drawn = draw(material, view, sensor=Sensor(clip=clip, cfa=cfa), seed=100 + seed)
        folder = drawn.write(tmp_path / str(seed))
        pictures, radiometry = merge(read_capture(folder))
        true = {one["exposure"]: one["relative"] for one in drawn.truth["exposures"]}
        unit = true[radiometry.reference_exposure]
        for exposure, found in radiometry.exposures.items():
            if exposure != radiometry.reference_exposure:
                error = found.value * unit / true[exposure] - 1
                ratios.append(error)
                pulls.append(error / (found.std / found.value))
        clips.append(radiometry.clip.level / drawn.truth["clip_dn"] - 1)
        gains.append((radiometry.gain.value - 0.5, radiometry.gain.std))
        lamps = np.array([one["gain"] for one in drawn.truth["lamps"]])
        found = np.array([radiometry.lamp_output[one["lamp"]].value for one in drawn.truth["lamps"]])
        outputs += list(found / lamps * lamps.mean() - 1)
        picture = pictures[9]
        clean = noiseless(drawn, picture.name) * unit * 0.5 / radiometry.gain.value
        good = ~picture.clipped & np.isfinite(picture.values)
        good[:50, :50] = False
        pull = ((picture.values - clean) / picture.std)[good]
        merged.append((pull.mean(), pull.std()))
        for path in folder.glob("*/*.tif"):
            path.unlink()
        print(name, alpha, family, "ratios", np.round(1e4 * np.array(ratios[-4:]), 2), "e-4, pulls", np.round(pulls[-4:], 2),
              "clip", clips[-1], "gain", gains[-1], "merged", merged[-1], flush=True)  # fmt: skip
    rms = lambda values: float(np.sqrt(np.mean(np.square(values))))  # noqa: E731
    gain_pulls = [error / std for error, std in gains]
    summary = {
        "ratios_rms": rms(ratios), "ratio_pull_rms": rms(pulls), "clip_max": float(np.abs(clips).max()),
        "gain_rms": rms([g / 0.5 for g, _ in gains]), "gain_pull_rms": rms(gain_pulls), "output_rms": rms(outputs),
    }  # fmt: skip
    print(json.dumps(summary))
    assert summary["ratios_rms"] <= 1e-3
    assert 0.4 < summary["ratio_pull_rms"] < 1.6
    assert summary["clip_max"] <= 5e-3
    assert summary["output_rms"] <= 1e-3
    assert summary["gain_pull_rms"] < 2.5
    assert all(abs(mean) < 0.05 and 0.93 < std < 1.07 for mean, std in merged)
