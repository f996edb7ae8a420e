"""
Nodes of the integral over a pixel
==================================

A pixel integrates the light of the surface under its kernel, at nodes on circles of normals. About a highlight the circles are
denser towards its normal. At the limb they run along the surface that the pixel sees, and end where the surface is not visible.
"""

import matplotlib.pyplot as plt
import numpy as np

import matcam
from matcam.forward.integral.blur import imaging_of
from matcam.forward.sampler.arc_rules import arc_rule
from matcam.forward.sampler.plan import RecordPositions, record_plan

lamp_angle = np.radians(80)
rig = matcam.rigs.merl()
highlight = 256 * np.sin(lamp_angle / 2)
pixels = np.array([[highlight + 0.4, 0.2], [250.0, 54.0]])  # one beside the highlight, one at the limb
positions = RecordPositions(*pixels.T, np.full(2, lamp_angle))
part = record_plan(imaging_of(rig), positions, finest=0.001).parts[0]

figure, axes = plt.subplots(1, 2, figsize=(9, 4.6))
for number, (axis, (x, y)) in enumerate(zip(axes, pixels, strict=True)):
    total = 0
    for even, arcs in enumerate((part.arcs, part.even_arcs)):
        own = arcs.at(np.flatnonzero(arcs.position == number))
        total += own.nodes.sum()
        # axis of the circles, and the directions of azimuth 0 and 90 degrees
        frame = part.frames[own.window].reshape(-1, 3, 3)
        for nodes, angle, middle, half, vectors in zip(own.nodes, own.angle, own.middle, own.half, frame, strict=True):
            azimuth = middle + half * arc_rule(bool(even), int(nodes))[0]
            circle = np.stack(
                [np.full(nodes, np.cos(angle)), np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth)]
            )
            normal = vectors.T @ circle
            axis.plot(256 * normal[0] - x, 256 * normal[1] - y, ".", color="C0", markersize=1.5)
    turn = np.linspace(0, np.pi, 2000)
    axis.plot(256 * np.sin(turn) - x, 256 * np.cos(turn) - y, color="C1", label="limb")
    axis.add_patch(plt.Rectangle((-0.5, -0.5), 1, 1, fill=False, label="pixel"))
    axis.set(xlim=(-3.4, 3.4), ylim=(-3.4, 3.4), aspect="equal", xlabel="right of the pixel [px]")
    axis.set_title(f"{total} nodes {('about a highlight', 'at the limb')[number]}")
axes[0].set_ylabel("above the pixel [px]")
axes[1].legend(loc="upper right")
figure.tight_layout()
