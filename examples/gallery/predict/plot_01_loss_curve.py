"""
Predict the loss of a highlight
===============================

A lens of 0.5 px and a full pixel before a sphere of 256 px: the MERL rig as the paper reconstructs it. Towards the limb the
same blur covers more angle, so narrow lobes lose most.
"""

import matplotlib.pyplot as plt
import numpy as np

import matcam

rig = matcam.rigs.merl()
theta = np.radians(np.linspace(0, 88, 89))

figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for alpha in (0.001, 0.003, 0.01, 0.03):
    kept = np.asarray(matcam.peak_response(rig, matcam.GGX(alpha), theta))
    angle = np.degrees(float(matcam.loss_angle(rig, matcam.GGX(alpha))))
    axes.plot(np.degrees(theta), kept, label=f"alpha {alpha:g}: 5 % lost at {angle:.0f}°")
axes.set(xlabel="angle of the light, degrees", ylabel="recorded / true peak", ylim=(0, 1), xlim=(0, 90))
axes.legend()
plt.show()
