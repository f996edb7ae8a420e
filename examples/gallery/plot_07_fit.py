"""
How rough is this metal, seen through its camera?
=================================================

The table is chromium of alpha 0.004. Its highlight is half a pixel wide. Fitted as if the camera were perfect it looks
rougher, and needs twenty times the noise; through the camera the true value comes back, with an error that contains it.
"""

import matplotlib.pyplot as plt

import matcam

ALPHA = 0.004  # the true roughness

table = matcam.io.example_table()
through = matcam.fit(table, matcam.rigs.merl(), "ggx", every=18)
blind = matcam.fit(table, None, "ggx", every=18)

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
for row, (title, found) in enumerate({"through the camera": through, "as if it were perfect": blind}.items()):
    alpha, std = found.params["alpha"], found.std["alpha"]
    print(f"{title}: alpha {alpha:.5f} ± {std:.5f}, noise of a pixel {found.noise.relative:.1%}")
    axes.errorbar(alpha, row, xerr=std, fmt="o", label=title)
axes.axvline(ALPHA, color="0.6", lw=3, zorder=0, label="the truth")
axes.set(xlabel="roughness alpha", yticks=[], ylim=(-1, 2), xlim=(0, 1.1 * max(blind.params["alpha"], ALPHA)))
axes.legend(loc="center")
plt.show()
