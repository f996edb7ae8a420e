"""
Merge exposures of a highlight
==============================

A sensor with a full well of 20,000 electrons records a scene of 1 to 30,000. Each exposure covers a part of the range. Merged by
their variances, the exposures cover all of it, with an error at every pixel.
"""

import matplotlib.pyplot as plt
import numpy as np

import matcam
from matcam.camera import expose_bracket, merge_bracket

sensor = matcam.Sensor(pitch=4e-6, full_well=2e4, read_noise=3.0, gain=0.5, bits=14)
camera = matcam.Camera(matcam.GaussianOptics(0.5), sensor=sensor)
radiance = np.geomspace(1, 3e4, 300)[None, :].repeat(40, axis=0)
exposures = (0.5, 4.0, 32.0)
pictures = expose_bracket(sensor, radiance, exposures, seed=3)
merged = merge_bracket(sensor, pictures, exposures)

figure, axes = plt.subplots(figsize=(7, 3.8), layout="constrained")
axes.loglog(radiance[0], np.std(np.asarray(merged.radiance) / radiance, axis=0), ".", ms=3, label="scatter of 40 rows")
axes.loglog(radiance[0], np.mean(np.asarray(merged.std) / radiance, axis=0), "k", label="predicted")
axes.set(xlabel="radiance", ylabel="relative error of the merged image")
axes.legend()
plt.show()
