"""
Render a measured material in Mitsuba
=====================================

The RGL format contains a BRDF on a grid adapted to its lobe. Mitsuba 3 reads it as `measured`. Here Mitsuba renders a file
written by matcam.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import mitsuba
import numpy as np

import matcam

gold = matcam.Microfacet(matcam.GGX(0.1), matcam.Conductor.from_metal("Au", [610e-9, 550e-9, 465e-9]))
fields = matcam.exchange.adaptive_grid(gold, square=48)

mitsuba.set_variant("scalar_rgb")
with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "gold.bsdf"
    matcam.io.write_rgl(path, fields)
    print(f"{path.name}: {path.stat().st_size / 1e6:.1f} MB")
    scene = mitsuba.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct"},
            "sensor": {
                "type": "perspective",
                "fov": 24,
                "to_world": mitsuba.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 96, "height": 96, "rfilter": {"type": "box"}},
                "sampler": {"type": "independent", "sample_count": 16},
            },
            "light": {"type": "directional", "direction": [-1, -1, -1], "irradiance": 3.0},
            "sky": {"type": "constant", "radiance": 0.25},
            "sphere": {"type": "sphere", "material": {"type": "measured", "filename": str(path)}},
        }
    )
    image = np.asarray(mitsuba.render(scene))[..., :3]

figure, axes = plt.subplots(figsize=(4, 4), layout="constrained")
axes.imshow(np.clip(image, 0, 1) ** (1 / 2.2))
axes.set(title="gold, alpha 0.1, rendered by Mitsuba 3", xticks=[], yticks=[])
plt.show()
