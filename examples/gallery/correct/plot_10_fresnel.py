"""
Find the Fresnel term of a metal
================================

The ratio of recorded peaks (raw) falls where the Fresnel term of chromium rises. The strengths of a lobe fitted through the camera
follow the published tables.
"""

import matplotlib.pyplot as plt

import matcam

STEP = 6  # the table holds every sixth slice

result = matcam.fresnel(matcam.io.example_table(), matcam.rigs.merl(), ndf="ggx", slice_step=STEP)
print(result.matcam.summary())
result.matcam.plot(metal="Cr")
plt.show()
