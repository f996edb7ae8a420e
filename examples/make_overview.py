"""Draw docs/images/overview.png: a highlight, its record, the measured camera, and the Fresnel term of the corrected table.

Run it in the root of the sources: `python examples/make_overview.py`
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.ndimage import gaussian_filter

import matcam

ALPHA, RADIUS, SIGMA, FINE, HALF = (
    0.004,
    256.0,
    0.5,
    40,
    4,
)  # roughness, px, px, samples per pixel, half width of the view in px

x = (np.arange(2 * HALF * FINE) + 0.5) / FINE - HALF
across, along = np.meshgrid(x, x)
lobe = np.asarray(matcam.GGX(ALPHA).d(np.hypot(across, along) / RADIUS))
lobe = lobe / lobe.max()
pixels = gaussian_filter(lobe, SIGMA * FINE).reshape(2 * HALF, FINE, 2 * HALF, FINE).mean((1, 3))

rig = matcam.rigs.merl()
angles = np.radians(np.linspace(5, 80, 60))
n, k = matcam.metal("Cr", [550e-9])[:2]
fresnel = np.asarray(matcam.fresnel_conductor(angles, np.asarray(n), np.asarray(k))).squeeze()
kept = np.asarray(matcam.peak_response(rig, matcam.GGX(ALPHA), angles))
frequency = np.linspace(0, 1, 100)

plt.rcParams.update({"font.size": 13})
figure, panels = plt.subplots(1, 4, figsize=(15, 4.2), layout="constrained", width_ratios=(1, 1, 1.15, 1.25))
for axes, values, title in (
    (panels[0], lobe, "1  A narrow highlight"),
    (panels[1], pixels, "2  as the camera records it"),
):
    axes.imshow(
        np.log10(np.maximum(values, 1e-4)), cmap="inferno", vmin=-3.5, vmax=0, extent=(-HALF, HALF, -HALF, HALF)
    )
    axes.set(title=title, xlabel="position, px", xticks=(-4, 0, 4), yticks=(-4, 0, 4))
panels[1].set_xlabel(f"peak: {pixels.max():.0%} of the true one")
panels[2].plot(frequency, np.asarray(rig.camera.mtf(frequency)), lw=3, color="#0072b2")
panels[2].set(title="3  The measured camera", xlabel="frequency, cycles/px", ylabel="MTF", xlim=(0, 1), ylim=(0, 1.02))
low = fresnel / fresnel[0]
panels[3].plot(np.degrees(angles), low * kept / kept[0], lw=3, color="#d55e00", label="raw")
panels[3].plot(np.degrees(angles), low, lw=3, color="#0072b2", label="corrected")
panels[3].set(
    title="4  The corrected table", xlabel="difference angle, degrees", ylabel="peak (Fresnel term)", ylim=(0, 1.1)
)
panels[3].legend(loc="lower left", frameon=False)
figure.savefig(Path(__file__).parents[1] / "docs" / "images" / "overview.png", dpi=80)
