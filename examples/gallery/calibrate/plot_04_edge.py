"""
Measure the MTF from a slanted edge
===================================

`edge_mtf` finds the edge in an image and measures the MTF twice, with standard deviations: without a model, and as that of a
lens.
"""

import numpy as np

import matcam
from matcam.figures.calibration import edge_figure

camera = matcam.Camera(matcam.GaussianOptics(0.45), matcam.BoxPixel(0.5))  # what we want to find
angle = np.radians(5)
y, x = np.mgrid[:100, :80]
distance = (x - 40) * np.cos(angle) + (y - 50) * np.sin(angle)
light = 0.1 + 0.7 * np.asarray(camera.esf(distance, angle))
photograph = light + np.random.default_rng(1).normal(0, 0.01, light.shape)  # SNR 80 in the white

found = matcam.edge_mtf(photograph, tone="linear")
print(found.summary())
print("the lens was 0.45 px")

drawn = edge_figure(found, photograph, None, "one edge")  # drawn.savefig("edge.png")
