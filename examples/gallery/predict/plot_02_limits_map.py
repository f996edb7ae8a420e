"""
Map the loss over roughness and angle
=====================================

Share of the peak that is kept, relative to normal view. On the line of 0.95, 5 % are lost. Above the line less is lost, so peaks
give the relative reflectance to 5 % without a correction. At the bottom of the map the lobe is much narrower than the blur. The
share is then close to the cosine of the angle for every roughness, so the record does not determine the roughness.
"""

import matplotlib.pyplot as plt
import numpy as np

import matcam

rig = matcam.rigs.merl()
theta = np.radians(np.linspace(0, 88, 45))
roughness = np.geomspace(3e-4, 0.3, 25)
kept = np.array([np.asarray(matcam.peak_response(rig, matcam.GGX(alpha), theta)) for alpha in roughness])

figure, axes = plt.subplots(figsize=(7, 4.2), layout="constrained")
shades = axes.contourf(np.degrees(theta), roughness, kept / kept[:, :1], levels=np.linspace(0, 1, 11), cmap="cividis")
lines = axes.contour(np.degrees(theta), roughness, kept / kept[:, :1], levels=[0.5, 0.95], colors="white")
axes.clabel(lines)
axes.set(yscale="log", xlabel="angle of the light, degrees", ylabel="roughness alpha")
figure.colorbar(shades, label="peak kept, relative to normal view")
plt.show()

# %%
# The roughness at which a rig loses 5 % at 75 degrees; rougher materials lose less:

fine = np.geomspace(0.005, 0.2, 100)
for radius in (128, 256, 1024):
    of_radius = matcam.Rig(rig.camera, matcam.Sphere(radius))
    ends = np.array([matcam.peak_response(of_radius, matcam.GGX(alpha), np.radians([0, 75])) for alpha in fine])
    alpha = np.exp(np.interp(0.95, ends[:, 1] / ends[:, 0], np.log(fine)))
    print(f"sphere of {radius} px: alpha {alpha:.3g}")
