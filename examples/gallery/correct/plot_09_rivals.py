"""
Compare camera blur with free shadowing
=======================================

A lobe that darkens towards grazing angles may be blurred, or the facets may shadow each other in an unknown way. Both models are
fitted to the same data, and compared by their evidence: the probability of the data under each model. A fit permits a noise of a
pixel of 20 % at most, so a model with this noise requires at least 20 %.
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
