"""
Do the photographs say what the fit says?
=========================================

`reconstruct` explains the pixels of every highlight by one material, one lens and one geometry. Recorded, fitted, and what is
left in standard deviations of the noise: where the model lacks something, a pattern stays. Here none does.

The photographs are those of the tutorial *From a folder of photographs to a material*. If they are not there, they are simulated.
"""

import tempfile
from pathlib import Path

import numpy as np

import matcam
from matcam.figures.reconstruction_page import highlight_figure
from matcam.forward.synthetic_capture import CapturePlan, simulate_capture

folder = Path(tempfile.gettempdir()) / "matcam-example-capture"
if not (folder / "truth.json").exists():  # the simulation writes it last
    chromium = matcam.Microfacet(matcam.GGX(0.03), matcam.Conductor(*matcam.metal("Cr", [550e-9])[:2]))
    sensor = matcam.Sensor(pitch=5e-6, full_well=30_000, read_noise=3.0, gain=0.5, bits=14, black_level=256)
    rig = matcam.Rig(matcam.Camera(matcam.GaussianOptics(0.5), sensor=sensor), matcam.Sphere(64.0))
    plan = CapturePlan(np.radians(np.linspace(8, 75, 6)), azimuth=0.4)
    simulate_capture(chromium, rig, plan, folder, seed=5, force=True)

found = matcam.reconstruct(folder, ndf="ggx")  # yours: matcam.reconstruct("shots/")
for picture, chi2 in zip(found.fit.names, found.fit.solution.chi2, strict=True):
    print(f"{picture}: chi² a pixel {chi2:.2f}")
drawn = highlight_figure(found)  # drawn.savefig("highlights.png")
