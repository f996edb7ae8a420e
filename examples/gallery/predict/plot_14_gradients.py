"""
Differentiate a record
======================

Materials, lenses and rigs are JAX trees, so all results have derivatives. Here: the recorded peak, with respect to the blur of the
lens and to the roughness of the lobe.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import matcam

theta = np.radians(np.linspace(0, 85, 35))


def peak(sigma, alpha):
    """Return the recorded over the true peak."""
    rig = matcam.Rig(matcam.Camera(matcam.GaussianOptics(sigma)), matcam.Sphere(256.0))
    return matcam.peak_response(rig, matcam.GGX(alpha), theta)


by_blur, by_roughness = jax.jacfwd(peak, argnums=(0, 1))(0.5, 0.004)
kept = np.asarray(peak(0.5, 0.004))

figure, axes = plt.subplots(figsize=(7, 3.8), layout="constrained")
axes.plot(np.degrees(theta), 0.5 * np.asarray(by_blur) / kept, label="blur of the lens")
axes.plot(np.degrees(theta), 0.004 * np.asarray(by_roughness) / kept, label="roughness")
axes.axhline(0, color="0.7", lw=1)
axes.set(xlabel="angle of the light, degrees", ylabel="change of the peak for +1 %, %")
axes.legend()
plt.show()
