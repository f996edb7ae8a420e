"""
Fit the roughness through the camera
====================================

The table is chromium of alpha 0.004, with a highlight of half a pixel and 1 % noise of a pixel. A fit that assumes a perfect camera
finds a larger roughness and a noise of at least 20 %, the largest noise that a fit permits: it cannot explain the table. The fit
through the camera finds the true values within its errors.
"""

import matplotlib.pyplot as plt

import matcam
from matcam.inverse.fit.fit_data import noise_text

ALPHA = 0.004  # the true roughness

table = matcam.io.example_table()
through = matcam.fit(table, matcam.rigs.merl(), "ggx", slice_step=18)
blind = matcam.fit(table, None, "ggx", slice_step=18)

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
for row, (title, found) in enumerate({"through the camera": through, "as if it were perfect": blind}.items()):
    alpha, std = found.params["alpha"], found.std["alpha"]
    print(f"{title}: alpha {alpha:.6f} ± {std:.6f}, noise of a pixel {noise_text(found.noise)}")
    axes.errorbar(alpha, row, xerr=std, fmt="o", label=title)
axes.axvline(ALPHA, color="0.6", lw=3, zorder=0, label="truth")
axes.set(xlabel="roughness alpha", yticks=[], ylim=(-1, 2), xlim=(0, 1.1 * max(blind.params["alpha"], ALPHA)))
axes.legend(loc="center")
plt.show()

# %%
# The summary lists parameters, correlations and statistics.

print(through.summary())
