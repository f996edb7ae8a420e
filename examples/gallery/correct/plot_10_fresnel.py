"""
Find the Fresnel term of a metal
================================

The ratio of recorded peaks (raw) falls where the Fresnel term of chromium rises. The strengths of a lobe fitted through the camera
follow the published tables.
"""

import matcam
from matcam.figures.curves import fresnel_figure

EVERY = 6  # the table holds every sixth slice

result = matcam.fresnel(matcam.io.example_table(), matcam.rigs.merl(), ndf="ggx", slice_step=EVERY)
tables = matcam.inverse.tabulated_fresnel(result, "Cr")
drawn = fresnel_figure(result, tables, "chromium, simulated")  # drawn.savefig("fresnel.png")
