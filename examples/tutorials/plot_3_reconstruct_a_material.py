"""
From a folder of photographs to a material
==========================================

You have no table, but a sphere, a lamp that you can move, and the camera of the last tutorial. `reconstruct` reads the
photographs themselves: light, outline, lamps, lens and material are fitted together, each within what you know of it.

Here the photographs are drawn by code that shares nothing with matcam, so that the truth is known: chromium of roughness
alpha 0.03, a lens of 0.5 px, a sphere of only 64 px, so that this page is built quickly. Take 300 px or more.
"""

import matplotlib.pyplot as plt
import numpy as np

import matcam
from matcam.acquisition.capture_check import check_capture
from matcam.acquisition.outline import stacked
from matcam.figures.reconstruction_page import overview_figure
from matcam.files.capture import read_capture
from shared_capture import ALPHA, photographed, reconstructed, true_brdf, true_reflectance

# %%
# The folder
# ----------
#
# `matcam capture init shots` writes it empty, with two text files to fill in. `capture.toml` says what is known of the rig, each
# value with its standard deviation; `frames.csv` has one line a photograph.

folder = photographed()
print("\n".join((folder / "frames.csv").read_text().splitlines()[:6]))
for part in ("frames", "dark", "outline"):
    print(f"{part}/: {len(list((folder / part).iterdir()))} pictures")

# %%
# One lamp position needs several exposures: the highlight is a thousand times brighter than what lies beside it. Dark frames and a
# frame before a bright field complete the set.

capture = read_capture(folder)
figure, panels = plt.subplots(1, 4, figsize=(9, 2.6), layout="constrained")
shown = [*capture.of("frames", lamp="L03")[:5:2], *capture.of("outline")]
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

found = reconstructed()
print(found.verdict)

drawn = overview_figure(found, stacked(found.captured.pictures))

# %%
# What was found, and how sure it is
# ----------------------------------

alpha, lens = found.parameters["alpha"], found.parameters["sigma_px"]
print(f"alpha {alpha[0]:.5f} ± {alpha[1]:.5f}; the truth is {ALPHA}")
stated = matcam.Camera.load(folder / "camera.json").optics.sigma
print(f"lens {lens[0]:.4f} ± {lens[1]:.4f} px; the truth is 0.5 px, the profile said {stated:.3f} px ± 3 %")

# %%
# F is free in every picture. Nothing of known reflectance was in these, so it is relative; its shape is what counts.

theta = found.fit.solution.theta_d
strength = found.fit.strengths[:, 0] / found.units[0].value
error = np.sqrt(np.diag(found.fit.strengths_covariance())) / found.units[0].value
fine = np.linspace(theta[0], theta[-1], 100)
scale = np.mean(strength / true_reflectance(theta))

figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
axes.plot(np.degrees(fine), scale * true_reflectance(fine), color="0.75", lw=5, label="truth, scaled")
axes.errorbar(np.degrees(theta), strength, error, fmt="o", ms=4, label="found in each picture")
axes.set(xlabel="difference angle, degrees", ylabel="F, relative", ylim=(0.9, 1.02))
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
    truth = scale * true_brdf(at.theta_h.values, float(at.theta_d))
    axes.plot(degrees, truth, color="0.75", lw=5, label="truth")
    axes.plot(degrees, at.brdf, label="reconstructed")
    binned = found.pinhole.sel(theta_d=angle, method="nearest").isel(channel=1)
    axes.plot(degrees, binned.mean("phi_d"), ".", color="C3", ms=4, label="binned, as by a pinhole")
    axes.set(xscale="log", yscale="log", xlim=(0.1, 10), ylim=(truth[0] / 100, truth[0] * 1.5))
    axes.set(xlabel="half angle, degrees", title=f"theta_d {np.degrees(at.theta_d):.0f}°")
panels[0].set_ylabel("BRDF, relative")
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
