"""Make the data of `matcam.io.example_table`: what the MERL rig records of polished chromium (GGX, alpha 0.004) in 13 of
90 slices, with 1 % noise a pixel.

The values come from the tests' oracle, which shares no code with matcam. In each slice about 100 cells are filled, one of
every pixel; all others are missing. Run it in the root of the sources: `PYTHONPATH=. python examples/make_chromium.py`
"""

from pathlib import Path

import numpy as np
from tests.inverse.recorded import made
from tests.oracle import sphere_cells as oracle

import matcam

EVERY = 6
FILE = Path(__file__).parents[1] / "src" / "matcam" / "data" / "chromium.npz"


def chromium(slice_step: int = EVERY) -> dict[str, np.ndarray]:
    """Compute the arrays of the file. slice_step: spacing of the slices of theta_d."""
    shot = made(slice_step, oracle.Setup())
    theta_d = shot.cells.theta_d
    n, k = matcam.metal("Cr", [610e-9, 550e-9, 465e-9])[:2]
    fresnel = np.asarray(matcam.fresnel_conductor(theta_d[:, None], np.asarray(n), np.asarray(k)))
    random = np.random.default_rng(7)
    lobe = shot.rule.directions(oracle.GGX(0.004))
    values = [shot.rule.noisy(lobe * fresnel[:, None, None, c], random, gain=0.0) for c in range(3)]
    return {
        "theta_h": shot.cells.i_theta_h.astype(np.int16),
        "theta_d": np.asarray(shot.cells.slices, np.int16),
        "phi_d": shot.cells.i_phi_d.astype(np.int16),
        "valid": shot.cells.valid,
        "value": np.stack(values, axis=-1).astype(np.float32),
    }


if __name__ == "__main__":
    np.savez_compressed(FILE, **chromium())
