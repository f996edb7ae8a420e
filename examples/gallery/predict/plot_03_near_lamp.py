"""
See the effect of a near lamp
=============================

A lamp at a few radii has another direction at every point of the sphere. Assuming an infinite distance gives a wrong half vector
in every pixel. The lamp disc also looks larger from the highlight than from the centre.
"""

import matplotlib.pyplot as plt
import numpy as np

import matcam

# %%
# Error of the half vector over the image: angle between the true and the assumed half vector.

y, x = np.mgrid[1:-1:181j, -1:1:181j]
z = np.sqrt(np.where(x**2 + y**2 < 1, 1 - x**2 - y**2, np.nan))
surface = np.stack([x, y, z], axis=-1)
lamp_angle = np.radians(60)
far = np.array([np.sin(lamp_angle), 0, np.cos(lamp_angle)])
view = np.array([0, 0, 1.0])


def unit(vectors):
    """Return vectors of length 1."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


figure, panels = plt.subplots(1, 3, figsize=(9, 3.2), layout="constrained")
for axes, distance in zip(panels, (5, 28, 100), strict=True):
    half = unit(unit(distance * far - surface) + view)
    error = np.degrees(np.arccos(np.clip(half @ unit(far + view), -1, 1)))
    lit = np.where(np.sum(surface * far, axis=-1) > 0, error, np.nan)
    shades = axes.imshow(lit, cmap="cividis")
    figure.colorbar(shades, ax=axes, shrink=0.7)
    axes.set(title=f"lamp at {distance} radii: degrees", xticks=[], yticks=[])
plt.show()

# %%
# matcam models it exactly: specify the distance of the lamp in radii of the sample.

for lamp in (matcam.DistantLamp(0.01), matcam.NearLamp(28.0, 0.28), matcam.NearLamp(5.0, 0.05)):
    rig = matcam.Rig(matcam.rigs.merl().camera, matcam.Sphere(256.0), lamp)
    kept = np.asarray(matcam.peak_response(rig, matcam.GGX(0.005), np.radians([0, 60])))
    print(f"{lamp}: {kept[0]:.1%} of the peak kept at 0, {kept[1]:.1%} at 60 degrees")
