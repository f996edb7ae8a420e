"""
Compare three point spread functions
====================================

That of the lens, that of the pixel, and the effective one, which images show: the product of both transfer functions.
"""

import matplotlib.pyplot as plt
import numpy as np

import matcam

pitch, wavelength = 4e-6, 550e-9
f = np.linspace(0, 1.2, 121)
figure, panels = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained", sharey=True)
for axes, number in zip(panels, (4, 11), strict=True):
    lens = matcam.DiffractionOptics(number, wavelength, pitch)
    camera = matcam.Camera(lens, matcam.BoxPixel(0.5))
    axes.plot(f, lens.mtf(f), label="lens")
    axes.plot(f, np.sinc(f), label="pixel")
    axes.plot(f, camera.mtf(f), "k", label="both: effective")
    axes.axvline(0.5, color="0.7", lw=1)
    axes.set(title=f"perfect lens at f/{number}, pixels of 4 um", xlabel="frequency, cycles/px")
panels[0].legend()
panels[0].set(ylabel="transfer function")
plt.show()
