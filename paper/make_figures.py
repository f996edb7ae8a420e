"""Draw the figures of paper.md: `python paper/make_figures.py`."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import matcam
from matcam.figures.style import CYCLE, GREY, styled

HERE = Path(__file__).parent
rig = matcam.rigs.merl()
theta = np.radians(np.linspace(0, 88, 89))

with styled():
    figure, axes = plt.subplots(figsize=(5.4, 3), layout="constrained")
    for alpha, colour in zip((0.001, 0.003, 0.01, 0.03), CYCLE, strict=False):
        kept = matcam.peak_response(rig, matcam.GGX(alpha), theta)
        axes.plot(np.degrees(theta), kept, color=colour)
        axes.annotate(
            f"α = {alpha:g}", (2, kept[0]), xytext=(0, -4), textcoords="offset points", va="top", color=colour
        )
    axes.set(xlabel="difference angle, degrees", ylabel="recorded over true peak", xlim=(0, 90), ylim=(0, 1))
    figure.savefig(HERE / "loss.png", dpi=160)

    data = matcam.paper.figure_3_4(1.0, rig)
    figure, axes = plt.subplots(figsize=(5.4, 3), layout="constrained")
    for angle, colour in zip(data.theta_o.values, CYCLE, strict=False):
        one = data.sel(theta_o=angle)
        axes.plot(one.x, one["signal"], color=colour, linestyle=":")
        axes.plot(one.x, one["recorded"], color=colour, label=f"{np.degrees(angle):.0f}°")
    axes.plot([], [], color=GREY, linestyle=":", label="as it is")
    axes.plot([], [], color=GREY, label="as recorded")
    axes.set(xlabel="distance from the peak, px", ylabel="signal over its true peak", xlim=(-4, 4), ylim=(0, 1.02))
    axes.legend()
    figure.savefig(HERE / "lobe.png", dpi=160)
