"""
Correct your first table
========================

You have a table of a shiny metal, in MERL's format or another, and want to know what a perfect camera would have
measured. Here the table is simulated chromium, so that the truth is known: roughness alpha 0.004, a highlight of half a
pixel, 1 % noise a pixel.
"""

import matplotlib.pyplot as plt
import numpy as np

import matcam

ALPHA = 0.004  # the true roughness

table = matcam.io.example_table()  # yours: matcam.read_merl("chrome.binary"), or matcam.io.read of any format
print(dict(table.sizes), table.attrs.get("units", "1/sr"))

# %%
# Say which rig took it
# ---------------------
#
# A rig is a camera, a sample and a lamp. `rigs.merl()` is the paper's reading of the MERL rig; its lens is a guess, 0.5 ± 0.5 px,
# and it says so. Yours is a profile: the next tutorial measures one.

rig = matcam.rigs.merl()
print(rig.camera.optics, rig.camera.pixel, rig.sample, sep="\n")

# %%
# Correct it
# ----------
#
# One lobe is fitted through the camera to all difference angles jointly; true over recorded lobe then corrects every
# entry. `matcam.correct` returns the table alone; `Correction.of` keeps the fits that it was corrected by, too.

found = matcam.inverse.Correction.of(table, rig, "ggx")
fit = found.fit
print(f"alpha {fit.params['alpha']:.5f} ± {fit.std['alpha']:.5f}; the truth is {ALPHA}")
print(f"lens {fit.params['optics.sigma_px']:.4f} ± {fit.std['optics.sigma_px']:.4f} px; the truth is 0.5 px")
print(f"noise of a pixel {fit.noise.relative:.2%}")
for remark in found.remarks:
    print("remark:", remark.text)

# %%
# Read the result
# ---------------
#
# `brdf` is the corrected table, `brdf_std` its standard deviation, `supported` where the correction is known to 5 %, and
# `response` is recorded over true.

peak = found.table["response"].sel(theta_h=0, method="nearest").isel(phi_d=90)
angles = np.degrees(found.table.theta_d)

figure, axes = plt.subplots(figsize=(7, 3.8), layout="constrained")
axes.plot(angles, peak, label="recorded over true peak, as found")
true = matcam.peak_response(rig, matcam.GGX(ALPHA), found.table.theta_d.values)
axes.plot(angles, true, "k:", label="the truth, at the exact half vector")
axes.set(xlabel="difference angle, degrees", ylabel="share of the peak that is left", ylim=(0, 1), xlim=(0, 90))
axes.legend()
plt.show()

# %%
# The same on the command line, with a page to read and files for every other program:
#
# .. code-block:: sh
#
#    matcam correct chrome.binary -o chrome-corrected.binary
