"""
What does a wrong camera look like?
===================================

The same table, fitted with cameras that were not there. The sign to look for is the noise that the fit needs to
explain the data: 1 % is the pixels', and what is above it is the camera's fault.
"""

import matplotlib.pyplot as plt

import matcam

ALPHA = 0.004  # the true roughness

table = matcam.io.example_table()
sigmas = (0.4, 0.475, 0.5, 0.525, 0.6)
found = []
for sigma in sigmas:
    camera = matcam.Camera(matcam.GaussianOptics(sigma), matcam.rigs.merl().camera.pixel)
    rig = matcam.Rig(camera, matcam.Sphere(256.0))
    found.append(matcam.fit(table, rig, "ggx", every=18, camera_parameters="fixed"))

figure, (noise, rough) = plt.subplots(1, 2, figsize=(8, 3.4), layout="constrained")
noise.bar([f"{s:g}" for s in sigmas], [100 * f.noise.relative for f in found])
noise.set(xlabel="lens that is assumed, px", ylabel="noise needed, % of a pixel")
rough.plot(sigmas, [f.params["alpha"] for f in found], "o-")
rough.axhline(ALPHA, color="0.6", zorder=0)
rough.set(xlabel="lens that is assumed, px", ylabel="alpha found")
plt.show()
