"""
See the haze of a lens
======================

A lens that scatters a thousandth of its light creates a haze around every highlight. It looks like a second, broad lobe of the
material.
"""

import matplotlib.pyplot as plt
import numpy as np

import matcam

sharp = matcam.GaussianOptics(0.5)
x = np.geomspace(0.3, 100, 120)

figure, axes = plt.subplots(figsize=(7, 3.8), layout="constrained")
for fraction in (0, 1e-4, 1e-3, 1e-2):
    lens = matcam.HaloOptics(sharp, fraction, 30.0) if fraction else sharp
    kernel = np.asarray(matcam.Camera(lens).psf(x, 0.0))
    axes.loglog(x, np.maximum(kernel / kernel[0], 1e-12), label=f"{fraction:.2%} of the light scattered")
axes.set(xlabel="distance from the highlight, px", ylabel="recorded / peak", ylim=(1e-9, 2))
axes.legend()
plt.show()
