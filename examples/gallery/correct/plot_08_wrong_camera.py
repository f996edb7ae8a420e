"""
Recognise a wrong camera
========================

The same table, fitted with wrong cameras. The symptom is the noise that the fit requires: 1 % is the noise of the pixels, and the
excess is due to the camera.
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
    found.append(matcam.fit(table, rig, "ggx", slice_step=18, camera_parameters="fixed"))

figure, (noise, rough) = plt.subplots(1, 2, figsize=(8, 3.4), layout="constrained")
noise.bar([f"{s:g}" for s in sigmas], [100 * f.noise.relative for f in found])
noise.set(xlabel="assumed lens width, px", ylabel="required noise of a pixel, %")
rough.plot(sigmas, [f.params["alpha"] for f in found], "o-")
rough.axhline(ALPHA, color="0.6", zorder=0)
rough.set(xlabel="assumed lens width, px", ylabel="estimated alpha")
plt.show()
