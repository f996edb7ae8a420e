"""
Plan a rig
==========

Before anything is bought: how large must the sphere be in the picture, how small the lamp, and which roughness can the
rig still measure? Let the roughest answer be wanted to 75 degrees with less than 5 % lost.
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
# The blur is fixed on the sensor. A sphere that fills more pixels has sharper normals.

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
# Its disc blurs, too, and in the sample's angles, whatever the camera. Its share is small where its radius, over four, is far below
# the lobe.

for degrees in (0.0, 0.1, 0.25, 0.5):
    rig = matcam.Rig(gaussian, matcam.Sphere(512), matcam.DistantLamp(np.radians(degrees)))
    kept = np.asarray(matcam.peak_response(rig, matcam.GGX(0.005), np.radians([0, 60])))
    print(f"lamp of {degrees:4} degrees: {kept[0]:.1%} of the peak kept at 0, {kept[1]:.1%} at 60 degrees")

# %%
# Write the plan down
# -------------------
#
# A rig file holds it for every command: `matcam predict --rig rig.toml`, `matcam simulate --rig rig.toml`.

print(
    """schema = "matcam-rig-1"
camera = "camera.json"

[sample]
radius_px = 512

[lamp]
radius_deg = 0.1"""
)
