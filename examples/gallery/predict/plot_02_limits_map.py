"""
Map the loss over roughness and angle
=====================================

Share of the peak that is kept, relative to normal view. Right of the line of 0.95 a highlight needs no correction. Far to its left
it cannot be corrected.
"""

import matplotlib.pyplot as plt
import numpy as np

import matcam

rig = matcam.rigs.merl()
theta = np.radians(np.linspace(0, 88, 45))
roughness = np.geomspace(3e-4, 0.3, 25)
kept = np.array([np.asarray(matcam.peak_response(rig, matcam.GGX(alpha), theta)) for alpha in roughness])

figure, axes = plt.subplots(figsize=(7, 4.2), layout="constrained")
shades = axes.contourf(np.degrees(theta), roughness, kept / kept[:, :1], levels=np.linspace(0.1, 1, 10), cmap="cividis")
lines = axes.contour(np.degrees(theta), roughness, kept / kept[:, :1], levels=[0.5, 0.95], colors="white")
axes.clabel(lines)
axes.set(yscale="log", xlabel="angle of the light, degrees", ylabel="roughness alpha")
figure.colorbar(shades, label="peak kept, relative to normal view")
plt.show()

# %%
# The roughness from which on a rig loses less than 5 % up to 75 degrees:

for radius in (128, 256, 1024):
    of_radius = matcam.Rig(rig.camera, matcam.Sphere(radius))
    angles = np.degrees([float(matcam.loss_angle(of_radius, matcam.GGX(alpha))) for alpha in roughness])
    print(f"sphere of {radius} px: alpha {roughness[np.argmax(angles >= 75)]:.3f}")
