"""
Correct your first table
========================

This tutorial corrects the table of a shiny metal: it estimates what a perfect camera would have measured. The table is
simulated chromium, so the truth is known: roughness alpha 0.004, a highlight of half a pixel, 1 % noise per pixel.
"""

import matplotlib.pyplot as plt
import numpy as np

import matcam

ALPHA = 0.004  # the true roughness

table = matcam.io.example_table()  # yours: matcam.read("chrome.binary"), of any format
print(dict(table.sizes), table.attrs.get("units", "1/sr"))

# %%
# Describe the rig
# ----------------
#
# A rig is a camera, a sample and a lamp. `rigs.merl()` is the MERL rig as the paper reconstructs it. Its lens is a guess of
# 0.5 ± 0.5 px. Use a profile of your own camera where you have one; the next tutorial measures it.

rig = matcam.rigs.merl()
print(rig.camera.optics, rig.camera.pixel, rig.sample, sep="\n")

# %%
# Correct it
# ----------
#
# One lobe is fitted through the camera to all difference angles jointly. Each entry is then multiplied by the ratio of true to
# recorded lobe. `matcam.correct` returns the table; `Correction.of` also returns the fits.

found = matcam.inverse.Correction.of(table, rig, "ggx")
print(found.summary())
print(
    f"The truth is a roughness of {ALPHA}, a lens of 0.5 px, and a noise of 1 %; {found.fit.noise.relative:.2%} was found."
)

# %%
# Read the result
# ---------------
#
# `brdf` is the corrected table and `brdf_std` its standard deviation. `supported` marks entries whose correction is known to 5 %.
# `response` is the ratio of recorded to true value.

peak = found.table["response"].sel(theta_h=0, method="nearest").isel(phi_d=90).mean("channel")
angles = np.degrees(found.table.theta_d)

figure, axes = plt.subplots(figsize=(7, 3.8), layout="constrained")
axes.plot(angles, peak, label="recorded / true peak, estimated")
true = matcam.peak_response(rig, matcam.GGX(ALPHA), found.table.theta_d.values)
axes.plot(angles, true, "k:", label="truth")
axes.set(xlabel="difference angle, degrees", ylabel="share of the peak that is kept", ylim=(0, 1), xlim=(0, 90))
axes.legend()
plt.show()

# %%
# The command line does the same, and writes a page to read:
#
# .. code-block:: sh
#
#    matcam correct chrome.binary -o chrome-corrected.binary
