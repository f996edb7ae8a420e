"""
Compare a star with an edge
===========================

Two targets and two independent methods measure one camera. A difference indicates sharpening, which affects edges and not
stars.
"""

import matplotlib.pyplot as plt
import numpy as np

import matcam

camera = matcam.Camera(matcam.GaussianOptics(0.5), matcam.BoxPixel(0.5))
random = np.random.default_rng(2)

# %%
# A sinusoidal Siemens star of 36 cycles. At each position it is a wave of the local frequency, which the camera attenuates.

y, x = np.mgrid[:240, :240] - 119.6
radius, azimuth = np.hypot(x, y), np.arctan2(y, x)
frequency = 36 / (2 * np.pi * np.maximum(radius, 8))
passed = np.asarray(camera.mtf(frequency, azimuth + np.pi / 2))
star = 0.5 + 0.3 * passed * np.cos(36 * azimuth) * (radius < 112) + random.normal(0, 0.005, x.shape)

# %%
# An edge at 5 degrees.

angle = np.radians(5)
v, u = np.mgrid[:100, :80]
edge = 0.2 + 0.6 * np.asarray(camera.esf((u - 40) * np.cos(angle) + (v - 50) * np.sin(angle), angle))
edge += random.normal(0, 0.005, edge.shape)

by_star = matcam.targets.star_mtf(star, contrast=0.6).samples
by_edge = matcam.edge_mtf(edge, tone="linear")

figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
f = np.linspace(0, 0.6, 61)
axes.plot(f, camera.mtf(f), color="0.6", lw=4, label="truth, across rows")
axes.errorbar(by_star.frequency, by_star.mtf, by_star.mtf_std, fmt=".", label="star, four directions")
axes.plot(by_edge.frequency, by_edge.mtf, label="edge")
axes.set(xlim=(0, 0.6), ylim=(0, 1.02), xlabel="frequency, cycles/px", ylabel="MTF")
axes.legend()
plt.show()
