"""
Calibrate a camera from photographs
===================================

A correction is as accurate as the camera profile. This tutorial measures a camera from a photograph of slanted squares. A known
camera takes the photograph, so the truth is known.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import matcam

truth = matcam.Camera(matcam.GaussianOptics(0.55), matcam.BoxPixel(0.5))

# %%
# The photograph
# --------------
#
# Dark squares on paper, turned by five degrees. Away from its corners the edge of a square is recorded as the edge spread
# function of the camera.

tilt = np.radians(5)
rows, columns = np.mgrid[:240, :240]
page = np.full(rows.shape, 0.8)
for x0 in (65, 175):
    for y0 in (65, 175):
        along = (columns - x0) * np.cos(tilt) + (rows - y0) * np.sin(tilt)
        across = -(columns - x0) * np.sin(tilt) + (rows - y0) * np.cos(tilt)
        inside = np.ones(rows.shape)
        for distance, angle in ((along, tilt), (across, tilt + np.pi / 2)):
            for sign in (1, -1):
                inside = inside * np.asarray(truth.esf(sign * distance + 32, angle))
        page -= 0.7 * inside
photograph = page + np.random.default_rng(5).normal(0, 0.008, page.shape)

folder = Path(tempfile.mkdtemp())
matcam.io.write_float_tiff(folder / "chart.tif", photograph.astype(np.float32))

# %%
# Fit one camera to all edges
# ---------------------------
#
# `calibrate` finds and measures every edge.

found = matcam.calibrate([folder / "chart.tif"], half_width=0.5, tone="linear")
(fit,) = found.channels.values()
camera, lens, std = fit.camera, fit.values[0], fit.std[0]
print(f"lens {lens:.4f} ± {std:.4f} px; the truth is 0.55 px")

figure, (picture, curve) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
picture.imshow(photograph, cmap="gray", vmin=0, vmax=1)
picture.set(xticks=[], yticks=[], title="the photograph")
f = np.linspace(0, 0.6, 61)
curve.plot(f, truth.mtf(f), color="0.7", lw=5, label="truth")
curve.plot(f, camera.mtf(f), label="found")
curve.set(xlabel="frequency, cycles/px", ylabel="MTF", ylim=(0, 1.02), xlim=(0, 0.6))
curve.legend()
plt.show()

# %%
# The profile
# -----------
#
# The profile is a JSON file with units in its names and a covariance. Use it in every command:
# `matcam correct chrome.binary --camera camera.json`.

camera.save(folder / "camera.json")
print((folder / "camera.json").read_text()[:420], "...")

# %%
# On the command line:
#
# .. code-block:: sh
#
#    matcam chart squares star --pixels 4000 -o chart.pdf
#    matcam calibrate photographs/ --chart chart.json -o camera.json
