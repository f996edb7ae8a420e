"""Draw the figures of paper.md: `python paper/make_figures.py`."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import matcam

HERE = Path(__file__).parent
rig = matcam.rigs.merl()
theta = np.radians(np.linspace(0, 88, 89))

figure, axes = plt.subplots(figsize=(5, 3), layout="constrained")
for alpha in (0.001, 0.003, 0.01, 0.03):
    axes.plot(np.degrees(theta), matcam.peak_response(rig, matcam.GGX(alpha), theta), label=f"alpha {alpha:g}")
axes.set(xlabel="difference angle, degrees", ylabel="recorded over true peak", xlim=(0, 90), ylim=(0, 1))
axes.legend()
figure.savefig(HERE / "loss.png", dpi=160)

data = matcam.paper.figure_3_4(1.0, rig)
figure, axes = plt.subplots(figsize=(5, 3), layout="constrained")
for angle in data.theta_o.values:
    axes.plot(data.x, data["recorded"].sel(theta_o=angle), ".-", label=f"recorded at {np.degrees(angle):.0f}°")
axes.set(xlabel="distance from the peak, px", ylabel="recorded, over the true peak", xlim=(-5, 5))
axes.legend()
figure.savefig(HERE / "lobe.png", dpi=160)
