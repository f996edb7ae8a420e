"""Contents of a camera profile."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from matcam.camera.camera import Camera
from matcam.camera.optics.varying import VaryingOptics


def inspect_camera(path: str | Path) -> dict[str, Any]:
    """Report on a camera profile, as plain values (JSON).

    The report has parameters, standard deviations, MTF50 (cycles/px, along a row) and provenance. For a lens with
    colours, or one that varies over the image, it has MTF50 of each representative lens, by name.
    """
    camera = Camera.load(path)
    mtf50: float | dict[str, float]
    if isinstance(camera.optics, VaryingOptics):  # and thus without its own MTF
        mtf50 = {name: _mtf50(Camera(lens, camera.pixel)) for name, lens in camera.optics.named_lenses.items()}
    else:
        mtf50 = _mtf50(camera)
    return {
        "parameters": {name: float(value) for name, value in camera.parameters().items()},
        "std": camera.uncertainty.std() if camera.uncertainty else {},
        "mtf50_cycles_per_px": mtf50,
        "provenance": dataclasses.asdict(camera.provenance),
    }


def _mtf50(camera: Camera) -> float:
    """Compute the frequency along a row at which the MTF of a camera is one half, cycles/px; NaN beyond 2."""
    frequency = np.linspace(0, 2, 4001)
    below = np.flatnonzero(np.asarray(camera.mtf(frequency)) < 0.5)
    return float(frequency[below[0]]) if below.size else float("nan")
