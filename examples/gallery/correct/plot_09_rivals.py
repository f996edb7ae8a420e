"""
Compare camera blur with free shadowing
=======================================

A lobe that darkens towards grazing angles may be blurred, or the facets may shadow each other in an unknown way. Both models are
fitted to the same data, and Akaike's criterion compares them.
"""

import matplotlib.pyplot as plt

import matcam

found = matcam.rivals(matcam.io.example_table(), matcam.rigs.merl(), slice_step=18)
print(found.verdict)

figure, axes = plt.subplots(figsize=(7, 2.6), layout="constrained")
noise = {"the camera": found.camera.fit.noise.relative, "free shadowing": found.shadowing.fit.noise.relative}
axes.barh(list(noise), [100 * share for share in noise.values()])
axes.axvline(1, color="k", lw=1)
axes.set(xlabel="noise of a pixel that the model requires, % (line: truth)")
plt.show()
