"""
From a folder of photographs to a material
==========================================

You have no table, but a sphere, a lamp that you can move, and the camera of the last tutorial. `reconstruct` reads the
photographs themselves: light, outline, lamps, lens and material are fitted together, each within what you know of it.

Here the photographs are simulated, so that the truth is known: chromium of roughness alpha 0.03, a lens of 0.5 px, and a
sphere of only 64 px, so that this page is built quickly. Take 300 px or more. The simulation uses the same forward model as the
reconstruction, so this page cannot reveal an error of that model; the tests of matcam use an independent one.
"""

import shutil
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import matcam
from matcam.acquisition.capture_check import check_capture
from matcam.acquisition.outline import stacked
from matcam.figures.reconstruction_page import overview_figure
from matcam.files.capture import read_capture
from matcam.forward.synthetic_capture import CapturePlan, simulate_capture

ALPHA = 0.03  # the true roughness

# %%
# The photographs
# ---------------
#
# Yours come from your camera. These are of a chromium sphere under a lamp on an arc, with six lamp positions and five exposures
# each. The lamp angles and exposure times that the folder states are wrong by as much as those of a lab.

chromium = matcam.Microfacet(matcam.GGX(ALPHA), matcam.Conductor(*matcam.metal("Cr", [550e-9])[:2]))
sensor = matcam.Sensor(pitch=5e-6, full_well=30_000, read_noise=3.0, gain=0.5, bits=14, black_level=256)
rig = matcam.Rig(matcam.Camera(matcam.GaussianOptics(0.5), sensor=sensor), matcam.Sphere(64.0))
plan = CapturePlan(np.radians(np.linspace(8, 75, 6)), azimuth=0.4)

folder = Path(tempfile.gettempdir()) / "matcam-example-capture"
shutil.rmtree(folder, ignore_errors=True)
truth = simulate_capture(chromium, rig, plan, folder, seed=5)

# %%
# The folder
# ----------
#
# `matcam capture init shots` writes it empty, with two text files to fill in. `capture.toml` says what is known of the rig, each
# value with its standard deviation; `frames.csv` has one line a photograph.

print("\n".join((folder / "frames.csv").read_text().splitlines()[:6]))
for part in ("frames", "dark", "outline"):
    print(f"{part}/: {len(list((folder / part).iterdir()))} pictures")

# %%
# One lamp position needs several exposures: the highlight is a thousand times brighter than what lies beside it. Dark frames and a
# frame before a bright field complete the set.

capture = read_capture(folder)
figure, panels = plt.subplots(1, 4, figsize=(9, 2.6), layout="constrained")
shown = [*capture.of("frames", lamp="L03")[:5:2], *capture.of("outline")[:1]]
for axes, frame in zip(panels, shown, strict=True):
    axes.imshow(capture.read(frame).values, cmap="gray", vmin=256, vmax=15256)
    axes.set(xticks=[], yticks=[], title=f"{frame.lamp} {frame.exposure}" if frame.lamp else "outline")
plt.show()

# %%
# Check it while you are still in the lab
# ---------------------------------------
#
# `matcam capture check shots` names frames that are missing or clipped, angles that were left out, and what has moved. It reads
# exposure times and the clip level off the frames themselves.

checked = check_capture(capture)
for finding in checked.findings:
    print("found:", finding.text)

# %%
# Six lamp positions are few: 15 to 20 leave no gap.
#
# Reconstruct
# -----------
#
# `matcam.reconstruct("shots/", ndf="ggx")`, or `matcam reconstruct shots/ --ndf ggx -o chrome.binary`. Without `ndf`, other lobes
# are tried, too.

found = matcam.reconstruct(folder, ndf="ggx")
print(found.verdict)

drawn = overview_figure(found, stacked(found.captured.pictures))

# %%
# What was found, and how sure it is
# ----------------------------------

alpha, lens = found.parameters["alpha"], found.parameters["sigma_px"]
print(f"alpha {alpha[0]:.5f} ± {alpha[1]:.5f}; the truth is {ALPHA}")
print(f"lens {lens[0]:.4f} ± {lens[1]:.4f} px; the truth is 0.5 px")

# %%
# F is free in every picture. The white patch beside the sphere, whose reflectance is given, makes it absolute.

theta = found.fit.solution.theta_d
strength = found.fit.strengths[:, 0] / found.units[0].value
error = found.fit.strengths_std[:, 0] / found.units[0].value
fine = np.linspace(theta[0], theta[-1], 100)

figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
axes.plot(np.degrees(fine), chromium.fresnel.at(fine), color="0.75", lw=5, label="truth")
axes.errorbar(np.degrees(theta), strength, error, fmt="o", ms=4, label="found in each picture")
axes.set(xlabel="difference angle, degrees", ylabel="F")
axes.legend(loc="lower left")
plt.show()

# %%
# The table
# ---------
#
# `table` has the BRDF, its standard deviation, and which entries the photographs support. `pinhole` is what binning the same
# pixels gives, as if lens and pixel were points: at the peak it lacks what the camera took.

figure, panels = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
for axes, angle in zip(panels, (theta[1], theta[-1]), strict=True):
    at = found.table.sel(theta_d=angle, phi_d=np.pi / 2, method="nearest").isel(channel=1)
    degrees = np.degrees(at.theta_h)
    true = chromium.brdf(at.theta_h.values, float(at.theta_d), np.pi / 2)
    axes.plot(degrees, true, color="0.75", lw=5, label="truth")
    axes.plot(degrees, at.brdf, label="reconstructed")
    binned = found.pinhole.sel(theta_d=angle, method="nearest").isel(channel=1)
    axes.plot(degrees, binned.mean("phi_d"), ".", color="C3", ms=4, label="binned, as by a pinhole")
    axes.set(xscale="log", yscale="log", xlim=(0.1, 10), ylim=(true.max() / 100, true.max() * 1.5))
    axes.set(xlabel="half angle, degrees", title=f"theta_d {np.degrees(at.theta_d):.0f}°")
panels[0].set_ylabel("BRDF, 1/sr")
panels[0].legend(loc="lower left")
plt.show()

# %%
# Where the error comes from
# --------------------------
#
# A source's part is what would go from the variance if that source were exact: so it says what to improve in the lab.

for source, parts in found.budget.items():
    print(f"{source:15} F at grazing angles {parts['ratio']:6.2%}   roughness {parts['roughness']:7.3%}")

# %%
# The command writes MERL and NetCDF files and a page to read. To practise before you have photographs:
#
# .. code-block:: sh
#
#    matcam simulate --capture shots --radius 64 --roughness 0.03 --lamp-positions 6
#    matcam capture check shots
#    matcam reconstruct shots/ --ndf ggx -o chrome.binary
