"""
Inspect a table
===============

Albedo, widths of the lobe, and the trace of the camera: blur widens a highlight in the plane of light and view, and not across
it. A table without camera blur has no such trace.
"""

import matplotlib.pyplot as plt
import numpy as np

import matcam

material = matcam.Microfacet(matcam.GGX(0.05), [0.9, 0.7, 0.4], diffuse=[0.05, 0.04, 0.02])
table = matcam.forward.true_table(material)

albedo = matcam.material.albedo(material, np.radians([0, 60]))
widths = matcam.exchange.lobe_widths(table)
print("albedo at 0° and 60°:", np.round(np.asarray(albedo), 3).tolist())
print("camera:", matcam.exchange.camera_trace(table))

figure, axes = plt.subplots(figsize=(7, 3.6), layout="constrained")
for index, colour in enumerate(("C3", "C2", "C0")):
    slices = table.isel(channel=index, phi_d=90).sel(theta_d=[0, np.radians(60)], method="nearest")
    axes.semilogy(np.degrees(table.theta_h), slices[:, 0], color=colour, label=str(table.channel.values[index]))
    axes.semilogy(np.degrees(table.theta_h), slices[:, 1], color=colour, ls=":")
axes.set(xlabel="half angle, degrees (dotted: difference angle 60°)", ylabel="BRDF, 1/sr", xlim=(0, 60))
axes.legend()
plt.show()
