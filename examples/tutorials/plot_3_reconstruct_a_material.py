"""
From a folder of photographs to a material
==========================================

This tutorial reconstructs a material from photographs of a sphere under a moved lamp. `reconstruct` fits light, outline, lamps,
lens and material jointly; specified values are priors.

The photographs are simulated, so the truth is known: chromium of roughness alpha 0.03 and a lens of 0.5 px. The sphere has only
64 px so that the example is fast; use 300 px or more. Simulation and reconstruction share their forward model, so this page
cannot reveal an error of that model; the tests of matcam use an independent one.
"""

import shutil
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import matcam
from matcam.acquisition.capture_check import check_capture
from matcam.acquisition.outline import stacked
from matcam.figures.reconstruction_page import highlight_figure, overview_figure
from matcam.files.capture import read_capture
from matcam.forward.synthetic_capture import CapturePlan, simulate_capture

ALPHA = 0.03  # the true roughness

# %%
# The photographs
# ---------------
#
# A chromium sphere under a lamp on an arc, with four lamp positions and four exposures each. The specified lamp angles and
# exposure times have errors as in a laboratory.

chromium = matcam.Microfacet(matcam.GGX(ALPHA), matcam.Conductor(*matcam.metal("Cr", [550e-9])[:2]))
sensor = matcam.Sensor(pitch=5e-6, full_well=30_000, read_noise=3.0, gain=0.5, bits=14, black_level=256)
rig = matcam.Rig(matcam.Camera(matcam.GaussianOptics(0.5), sensor=sensor), matcam.Sphere(64.0))
plan = CapturePlan(np.radians(np.linspace(8, 75, 4)), azimuth=0.4, exposures=4)

folder = Path(tempfile.gettempdir()) / "matcam-example-capture"
shutil.rmtree(folder, ignore_errors=True)
truth = simulate_capture(chromium, rig, plan, folder, seed=5)

# %%
# The folder
# ----------
#
# `matcam capture init shots` writes an empty folder with two text files. `capture.toml` describes the rig, each value with its
# standard deviation. `frames.csv` has one line per photograph.

print("\n".join((folder / "frames.csv").read_text().splitlines()[:6]))
for part in ("frames", "dark", "outline"):
    print(f"{part}/: {len(list((folder / part).iterdir()))} pictures")

# %%
# Each lamp position requires several exposures, because the highlight is a thousand times brighter than its surroundings. Dark
# frames and a frame before a bright field complete the set.

capture = read_capture(folder)
figure, panels = plt.subplots(1, 5, figsize=(10, 2.4), layout="constrained")
shown = [*capture.of("frames", lamp="L03")[:4], *capture.of("outline")[:1]]
for axes, frame in zip(panels, shown, strict=True):
    axes.imshow(capture.read(frame).values, cmap="gray", vmin=256, vmax=15256)
    axes.set(xticks=[], yticks=[], title=f"{frame.lamp} {frame.exposure}" if frame.lamp else "outline")
plt.show()

# %%
# Check the capture in the laboratory
# -----------------------------------
#
# `matcam capture check shots` names missing and clipped frames, missing angles, and motion. Exposure times and the clip level are
# measured in the frames.

checked = check_capture(capture)
for finding in checked.findings:
    print("found:", finding.text)

# %%
# Four lamp positions are few: 15 to 20 leave no gap.
#
# Reconstruct
# -----------
#
# On the command line: `matcam reconstruct shots/ --ndf ggx -o chrome.binary`. Without `--ndf`, other lobes are compared.

found = matcam.reconstruct(folder, ndf="ggx")
print(found.verdict)

drawn = overview_figure(found, stacked(found.captured.pictures))

# %%
# Parameters and their errors
# ---------------------------

alpha, lens = found.parameters["alpha"], found.parameters["sigma_px"]
print(f"alpha {alpha[0]:.5f} ± {alpha[1]:.5f}; the truth is {ALPHA}")
print(f"lens {lens[0]:.4f} ± {lens[1]:.4f} px; the truth is 0.5 px")

# %%
# F is free in every image. The white patch beside the sphere, whose reflectance is known, makes it absolute.

theta = found.fit.solution.theta_d
strength = found.fit.strengths[:, 0] / found.units[0].value
error = found.fit.strengths_std[:, 0] / found.units[0].value
fine = np.linspace(theta[0], theta[-1], 100)

figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
axes.plot(np.degrees(fine), chromium.fresnel.at(fine), color="0.75", lw=5, label="truth")
axes.errorbar(np.degrees(theta), strength, error, fmt="o", ms=4, label="found in each image")
axes.set(xlabel="difference angle, degrees", ylabel="F")
axes.legend(loc="lower left")
plt.show()

# %%
# The table
# ---------
#
# `table` contains the BRDF, its standard deviation, and the flag of supported entries. `pinhole` results from binning the same
# pixels without a camera model: its peak is too low.

figure, panels = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
for axes, angle in zip(panels, (theta[1], theta[-1]), strict=True):
    at = found.table.sel(theta_d=angle, phi_d=np.pi / 2, method="nearest").isel(channel=1)
    degrees = np.degrees(at.theta_h)
    true = chromium.brdf(at.theta_h.values, float(at.theta_d), np.pi / 2)
    axes.plot(degrees, true, color="0.75", lw=5, label="truth")
    axes.plot(degrees, at.brdf, label="reconstructed")
    binned = found.pinhole.sel(theta_d=angle, method="nearest").isel(channel=1)
    axes.plot(degrees, binned.mean("phi_d"), ".", color="C3", ms=4, label="binned (pinhole)")
    axes.set(xscale="log", yscale="log", xlim=(0.1, 10), ylim=(true.max() / 100, true.max() * 1.5))
    axes.set(xlabel="half angle, degrees", title=f"theta_d {np.degrees(at.theta_d):.0f}°")
panels[0].set_ylabel("BRDF, 1/sr")
panels[0].legend(loc="lower left")
plt.show()

# %%
# Residuals
# ---------
#
# The pixels of every highlight: recorded, fitted, and residual in standard deviations of the noise. A pattern in the residual would
# indicate a defect of the model.

drawn = highlight_figure(found)

# %%
# Error budget
# ------------
#
# The part of a source is the variance that disappears if that source is exact. The largest part names what to improve.

for source, parts in found.budget.items():
    print(f"{source:15} F at grazing angles {parts['ratio']:6.2%}   roughness {parts['roughness']:7.3%}")

# %%
# The command writes MERL and NetCDF files and a page to read. To practise without photographs:
#
# .. code-block:: sh
#
#    matcam simulate --capture shots --radius 64 --roughness 0.03 --lamp-positions 6
#    matcam capture check shots
#    matcam reconstruct shots/ --ndf ggx -o chrome.binary
