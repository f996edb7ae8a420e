"""
From a folder of photographs to a material
==========================================

This tutorial reconstructs a material from photographs of a sphere under a moved lamp. `reconstruct` fits light, outline, lamps,
lens and material jointly; specified values are priors.

The photographs are simulated, so the truth is known: chromium of roughness alpha 0.03 and a lens of 0.5 px. They are drawn with 4 x
4 samples per pixel, independently of the integrals of matcam. The sphere has only 64 px so that the example is fast; use 300 px or
more.
"""

import shutil
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import tifffile
from scipy.ndimage import gaussian_filter

import matcam
from matcam.acquisition.capture_check import check_capture
from matcam.acquisition.outline import stacked
from matcam.figures.reconstruction_page import highlight_figure, overview_figure
from matcam.files.capture import read_capture

ALPHA, LENS, RADIUS = 0.03, 0.5, 64  # the true roughness; standard deviation of the lens and radius of the sphere, px
WELL, READ, BLACK = (
    30_000,
    3.0,
    256,
)  # full well and read noise, electrons; black level, codes; two electrons are one code
SIDE, FINE = 2 * RADIUS + 32, 4  # size of an image, px; samples per pixel

chromium = matcam.Microfacet(matcam.GGX(ALPHA), matcam.Conductor.from_metal("Cr", [550e-9]))
theta_d = np.radians([8, 31, 53, 75])  # half the angle between lamp and camera, for each of four lamp positions
random = np.random.default_rng(5)

# %%
# The photographs
# ---------------
#
# Yours come from your camera. The function computes the light of the sphere under a distant lamp in every sample; lens and pixel
# then average it.

x = (np.arange(SIDE * FINE) + 0.5) / FINE - SIDE / 2
columns, rows = np.meshgrid(x / RADIUS, -x / RADIUS)
height = np.sqrt(np.maximum(1 - columns**2 - rows**2, 0))
normal = np.stack([columns, rows, height])


def through_camera(light):
    """Blur an image of samples by the lens and average it over the pixels. A sample is a square of variance 1 / 12."""
    return gaussian_filter(light, np.sqrt((LENS * FINE) ** 2 + 1 / 12)).reshape(SIDE, FINE, SIDE, FINE).mean((1, 3))


def light_of_sphere(theta):
    """Return radiance over irradiance of the sphere, under a lamp to the right."""
    lamp, half = (np.array([np.sin(angle), 0, np.cos(angle)]) for angle in (2 * theta, theta))
    cos_i, cos_h = (np.einsum("i,ijk", direction, normal) for direction in (lamp, half))
    lit = (height > 0) & (cos_i > 0)
    theta_h = np.arccos(np.clip(cos_h[lit], -1, 1))
    cos_h, cos_d = np.cos(theta_h), np.cos(theta)
    cos_phi = (cos_h * cos_d - cos_i[lit]) / np.maximum(np.sin(theta_h) * np.sin(theta), 1e-12)
    light = np.zeros_like(height)
    light[lit] = chromium.brdf(theta_h, theta, np.arccos(np.clip(cos_phi, -1, 1)))[..., 0] * cos_i[lit]
    return through_camera(light)


folder = Path(tempfile.gettempdir()) / "matcam-example-capture"
shutil.rmtree(folder, ignore_errors=True)
listed = ["file,lamp,angle_deg,azimuth_deg,exposure,time_s"]


def photograph(kind, name, exposure, electrons, words=",,"):
    """Write a frame of 14 bits with photon noise and read noise, and list it."""
    charge = np.minimum(random.poisson(electrons), WELL) + random.normal(0, READ, electrons.shape)
    (folder / kind).mkdir(parents=True, exist_ok=True)
    codes = np.clip(np.rint(BLACK + charge / 2), 0, 2**14 - 1).astype(np.uint16)
    tifffile.imwrite(folder / kind / f"{name}.tif", codes)
    listed.append(f"{kind}/{name}.tif,{words},E{exposure},{4**exposure / 1000:g}")


scenes = [light_of_sphere(theta) for theta in theta_d]
angles = 2 * np.degrees(theta_d) + random.normal(0, 0.3, len(theta_d))  # as accurate as in a laboratory
scale = 0.8 * WELL / max(scene.max() for scene in scenes)
for exposure in range(4):  # each 4 times the one before
    for number, scene in enumerate(scenes):
        electrons = np.minimum(scale * 4**exposure * scene, 4.0 * WELL)
        electrons[2:14, 2:14] = 0.7 * WELL * 4.0 ** (exposure - 3)  # a fibre from the lamp
        photograph("frames", f"L{number}_E{exposure}", exposure, electrons, f"L{number},{angles[number]:.2f},0")
    for number in range(2):
        photograph("dark", f"D{number}_E{exposure}", exposure, np.zeros((SIDE, SIDE)))
photograph("outline", "O0", 0, 0.6 * WELL * through_camera((height == 0).astype(float)))

# %%
# The folder
# ----------
#
# `matcam capture init shots` writes two text files to fill in. `capture.toml` describes the rig, each value with its standard
# deviation. `frames.csv` has one line per photograph.

(folder / "frames.csv").write_text("\n".join(listed) + "\n")
(folder / "capture.toml").write_text(
    """format = "matcam capture"
version = 1
camera = {profile = "camera.json"}
sample = {kind = "sphere"}
lamp = {motion = "arc", direction_std_deg = 0.3, intensity = "reference"}
reference = {kind = "monitor", region_px = [2, 2, 12, 12]}
outline = {field_beyond_deg = 0.0}
"""
)
known = matcam.camera.Uncertainty.of({"optics.sigma_px": 0.1 * LENS})  # the lens, to 10 %
matcam.Camera(matcam.GaussianOptics(LENS), matcam.BoxPixel(0.5), uncertainty=known).save(folder / "camera.json")
print("\n".join((folder / "frames.csv").read_text().splitlines()[:6]))

# %%
# Each lamp position requires several exposures, because the highlight is a thousand times brighter than its surroundings. Dark
# frames and a frame before a bright field complete the set.

capture = read_capture(folder)
figure, panels = plt.subplots(1, 5, figsize=(10, 2.4), layout="constrained")
shown = [*capture.of("frames", lamp="L2")[:4], *capture.of("outline")[:1]]
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
# F is free in every image. Without a white patch it is relative: here to the first image.

theta = found.fit.solution.theta_d
strength, error = (
    values[:, 0] / found.fit.strengths[0, 0] for values in (found.fit.strengths, found.fit.strengths_std)
)
fine = np.linspace(theta[0], theta[-1], 100)
truth = np.asarray(chromium.fresnel.at(fine)) / np.asarray(chromium.fresnel.at(theta[:1]))

figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
axes.plot(np.degrees(fine), truth, color="0.75", lw=5, label="truth")
axes.errorbar(np.degrees(theta), strength, error, fmt="o", ms=4, label="found in each image")
axes.set(xlabel="difference angle, degrees", ylabel="F, relative to the first image")
axes.legend(loc="lower left")
plt.show()

# %%
# The table
# ---------
#
# `table` contains the BRDF, its standard deviation, and the flag of supported entries. Without a white patch its F is relative, with
# a maximum of 1 between the first and the last angle. The true BRDF is therefore divided by the maximum of the true F.
#
# `pinhole` results from binning the same pixels without a camera model. Near the peak its values are too low. At grazing angles its
# flank is too high, because the blur widens the lobe in the plane of light and view. The points are means over phi_d.

largest = np.max(chromium.fresnel.at(fine))
figure, panels = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
for axes, angle in zip(panels, (theta[1], theta[-1]), strict=True):
    at = found.table.sel(theta_d=angle, phi_d=np.pi / 2, method="nearest").isel(channel=1)
    degrees = np.degrees(at.theta_h)
    true = chromium.brdf(at.theta_h.values, float(at.theta_d), np.pi / 2) / largest
    axes.plot(degrees, true, color="0.75", lw=5, label="truth")
    axes.plot(degrees, at.brdf, label="reconstructed")
    binned = found.pinhole.sel(theta_d=angle, method="nearest").isel(channel=1)
    axes.plot(degrees, binned.mean("phi_d"), ".", color="C3", ms=4, label="binned (pinhole)")
    axes.set(xscale="log", yscale="log", xlim=(0.1, 10), ylim=(true.max() / 100, true.max() * 1.5))
    axes.set(xlabel="half angle, degrees", title=f"theta_d {np.degrees(at.theta_d):.0f}°")
panels[0].set_ylabel("BRDF for the relative F, 1/sr")
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
