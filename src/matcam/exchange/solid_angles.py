"""What a goniophotometer's user asks of a measurement: over which solid angle was the light collected? For a camera before a
sphere that is an equivalence, and this is how it comes about.

The camera's kernel k (lens and pixel) averages over 1 / integral of k^2 pixels, which is the pixel's area where the lens
does nothing. On a sphere of radius r px those are A / (r^2 cos theta_o) of solid angle of NORMALS. A goniophotometer holds
the sample still and averages over directions of VIEW; by moving the half vector as much, d omega_o = 4 cos theta_d
d omega_h: at the peak, where theta_o = theta_d, that is 4 A / r^2, the same at every angle. Before a near camera the line of
sight turns as well and the angle matters: then it is told for normal view. A distant cylinder's normals turn in one plane
only and fill no solid angle. What the light is collected by, the lens's pupil as the sample sees it, is another cone, and
the lamp's disc a third; all three widen a highlight.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from matcam.camera.camera import Camera
from matcam.core.errors import ArgumentError
from matcam.core.jax import jnp
from matcam.rigs import Rig

_REACH, _RINGS, _DIRECTIONS = 12.0, 6001, 64  # cycles/px; around: the box's transform has corners of its own


def effective_area(camera: Camera) -> float:
    """Noise-equivalent area of the camera's kernel, px^2: 1 / integral of k^2 = 1 / integral of its squared MTF over all
    frequencies (Parseval). A pixel of full fill without a lens has 1; Gaussians of std sigma have 4 pi sigma^2."""
    frequency = np.linspace(0, _REACH, _RINGS)
    angles = (np.arange(_DIRECTIONS) + 0.5) / _DIRECTIONS * np.pi / 4  # a square has eight such wedges
    squared = np.stack([np.asarray(camera.mtf(frequency, angle)) ** 2 for angle in angles])
    ring = 2 * np.pi * frequency * squared.mean(axis=0)
    # a bare pixel's squared transform falls as 1 / f^3 times f around the rings: what lies beyond is as much as the last octave
    half = frequency >= _REACH / 2
    beyond = np.trapezoid(ring[half], frequency[half])
    return float(1 / (np.trapezoid(ring, frequency) + beyond))


def receiver(rig: Rig) -> dict[str, float | None]:
    """Solid angles of a rig, sr: `equivalent_receiver_sr` (see above; None where the half vector does not turn in every
    direction: for a flat sample, and for a cylinder before a distant camera), `pupil_sr` (the lens seen from the sample,
    pi aperture^2 / 4), `lamp_sr`; and `kernel_area_px2`."""
    if not isinstance(rig, Rig):
        raise ArgumentError(f"rig must be a Rig such as rigs.merl(), got {type(rig).__name__}")
    area = effective_area(rig.camera)
    along, across = (float(px) for px in rig.sample.px_per_rad(jnp.zeros(())))
    turns = np.isfinite(along) and np.isfinite(across)
    return {
        "kernel_area_px2": area,
        "equivalent_receiver_sr": 4 * area / (along * across) if turns else None,
        "pupil_sr": float(np.pi * rig.aperture**2 / 4),
        "lamp_sr": float(2 * np.pi * (1 - np.cos(rig.lamp_radius))),
    }


def metadata(rig: Rig, **about: str) -> dict[str, Any]:
    """What a table's reader has to know, as a JSON document in the manner of the BRDF format of the BiRD and BxDiff projects
    (Lanevski et al. 2022): geometry with the receiver's solid angle, instrument, quantity. It is metadata alone, meant to lie
    beside a table in any format; about: strings such as sample, operator, date."""
    wrong = [name for name, value in about.items() if not isinstance(value, str)]
    if wrong:
        raise ArgumentError(f"{wrong[0]} must be text, got {about[wrong[0]]!r:.60}")
    solid = receiver(rig)
    note = "4 A / r^2 before a far camera: views that move the half vector as much as the kernel does, at the peak"
    return {
        "format": "matcam measurement metadata",
        "version": 1,
        "quantity": {"name": "BRDF", "unit": "1/sr"},
        "receiver": {"solid_angle_sr": solid["equivalent_receiver_sr"], "meaning": note, **solid},
        "source": {"solid_angle_sr": solid["lamp_sr"], "half_angle_rad": float(rig.lamp_radius)},
        "instrument": rig.description(),
        "cell_value": rig.cell_value,
        "about": about,
    }
