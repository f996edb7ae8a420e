"""
Plan a rig
==========

How large must the sphere be in the image, how small the lamp, and which roughness can the rig measure? The requirement of this
example is a relative loss of less than 5 % up to 75 degrees.
"""

import matplotlib.pyplot as plt
import numpy as np

import matcam

camera = matcam.Camera(matcam.DiffractionOptics(8.0, 550e-9, 4e-6), matcam.BoxPixel(0.5))
print(f"MTF of lens and pixel at a quarter of a cycle per px: {float(camera.mtf(0.25)):.3f}")

# %%
# The sphere
# ----------
#
# The blur is constant on the sensor. A sphere that covers more pixels has a finer angular resolution.

gaussian = matcam.Camera(matcam.GaussianOptics(0.5), matcam.BoxPixel(0.5))
roughness = np.geomspace(5e-4, 0.2, 24)
figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for radius in (128, 256, 512, 1024):
    rig = matcam.Rig(gaussian, matcam.Sphere(radius))
    angles = [np.degrees(float(matcam.loss_angle(rig, matcam.GGX(alpha)))) for alpha in roughness]
    axes.semilogx(roughness, angles, label=f"limb at {radius} px")
axes.axhline(75, color="0.7", lw=1)
axes.set(xlabel="roughness alpha", ylabel="angle at which 5 % are lost, degrees")
axes.legend()
plt.show()

# %%
# The lamp
# --------
#
# The lamp disc adds a blur in angle that does not depend on the camera. It is negligible where a quarter of its radius is far below
# the roughness.

for degrees in (0.0, 0.1, 0.25, 0.5):
    rig = matcam.Rig(gaussian, matcam.Sphere(512), matcam.DistantLamp(np.radians(degrees)))
    kept = np.asarray(matcam.peak_response(rig, matcam.GGX(0.005), np.radians([0, 60])))
    print(f"lamp of {degrees:4} degrees: {kept[0]:.1%} of the peak kept at 0, {kept[1]:.1%} at 60 degrees")

# %%
# Rig file
# --------
#
# A rig file specifies the rig for every command: `matcam predict --rig rig.toml`, `matcam simulate --rig rig.toml`.

print(
    """schema = "matcam-rig-1"
camera = "camera.json"

[sample]
radius_px = 512

[lamp]
radius_deg = 0.1"""
)
