"""
What does a near lamp change?
=============================

A lamp at three radii of the sphere stands in another direction from every point of it, and its light falls off. Both
are geometry, and exact.
"""

import matplotlib.pyplot as plt
import numpy as np

import matcam

camera = matcam.Camera(matcam.GaussianOptics(0.5))
gold = matcam.Microfacet(
    matcam.GGX(0.15), matcam.Conductor(*matcam.metal("Au", [610e-9, 550e-9, 465e-9])[:2]), diffuse=0.1
)
lamps = {"infinitely far": matcam.DistantLamp(), "at 3 radii": matcam.NearLamp(3.0)}

figure, panels = plt.subplots(1, 2, figsize=(7, 3.6), layout="constrained")
for axes, (title, lamp) in zip(panels, lamps.items(), strict=True):
    rig = matcam.Rig(camera, matcam.Sphere(24.0), lamp)
    image = np.asarray(matcam.picture(gold, rig, lamp_angle=np.radians(60), shape=(54, 54), error=1e-2))
    axes.imshow(np.clip(image / np.percentile(image, 99), 0, 1) ** (1 / 2.2))
    axes.set(title=f"lamp {title}", xticks=[], yticks=[])
plt.show()
