"""Solid angles of a rig in the terms of goniophotometers.

A camera and a sphere have an equivalent solid angle of the receiver. The kernel k of lens and pixel averages over the
area A = 1 / integral of k^2 (px^2). For a lens without blur, A is the area of the pixel. On a sphere of radius r px
this area covers normals in a solid angle of A / (r^2 cos theta_o). A goniophotometer has a fixed sample, and averages
over directions of view. Normals in a solid angle omega_h correspond to half vectors in an equal solid angle
on the fixed sample. The views with these half vectors fill a solid angle omega_o,

    d omega_o = 4 cos theta_d d omega_h,

where theta_d is the difference angle. At the peak theta_o = theta_d, so omega_o is 4 A / r^2 for every angle. For a
near camera the line of sight rotates as well, and this value applies to normal view only. The normals of a cylinder lie
in one plane and do not fill a solid angle if the camera is distant. The pupil of the lens, seen from the sample, is a
second cone of directions, and the source disc a third. All three widen a highlight.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from matcam.camera.camera import Camera
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.jax import jnp
from matcam.rigs import Rig


def solid_angles(rig: Rig) -> dict[str, float | None]:
    """Compute the solid angles of a rig's receiver, pupil and lamp.

    The receiver is that of an equivalent goniophotometer. The views in its solid angle move the half vector at the peak
    by the same amount as the kernel of lens and pixel does.

    Args:
        rig: camera, sample and lamp.

    Returns:
        `equivalent_receiver_sr`: solid angle of the receiver, sr. It is None if the half vector does not rotate in
        every direction, that is, for a flat sample, and for a cylinder with a distant camera. `pupil_sr`: solid angle
        of the lens seen from the sample, pi aperture^2 / 4, sr. `lamp_sr`: solid angle of the source disc, sr.
        `kernel_area_px2`: noise-equivalent area of the kernel, px^2.

    Raises:
        ArgumentError: `rig` is not a `Rig`.

    Source:
        docs/exchange.md, *The receiver's solid angle*.

    Example:
        >>> angles = matcam.exchange.solid_angles(matcam.rigs.merl())
        >>> print(f"{angles['equivalent_receiver_sr']:.2g} sr, {angles['kernel_area_px2']:.3g} px^2")
        0.00026 sr, 4.23 px^2
    """
    checks.instance("rig", rig, Rig, "rigs.merl()")
    area = effective_area(rig.camera)
    along, across = (float(px) for px in rig.px_per_rad(jnp.zeros(())))
    turns = np.isfinite(along) and np.isfinite(across)
    return {
        "kernel_area_px2": area,
        "equivalent_receiver_sr": 4 * area / (along * across) if turns else None,
        "pupil_sr": float(np.pi * rig.aperture**2 / 4),
        "lamp_sr": float(2 * np.pi * (1 - np.cos(rig.lamp_radius))),
    }


def metadata(rig: Rig, **about: str) -> dict[str, Any]:
    """Describe the measurement of a table as a JSON document.

    The document contains metadata for a table in any format: the quantity, the instrument, and the solid angles of the
    receiver and the source.

    Args:
        rig: camera, sample and lamp.
        **about: strings by name, such as sample, operator or date.

    Returns:
        The document, as plain values.

    Raises:
        ArgumentError: `rig` is not a `Rig`, or an entry of `about` is not a string.

    Source:
        Modelled on the BRDF format of the BiRD and BxDiff projects (Lanevski et al. 2022), with another schema.

    Example:
        >>> document = matcam.exchange.metadata(matcam.rigs.merl(), sample="chrome")
        >>> document["quantity"], document["about"]
        ({'name': 'BRDF', 'unit': '1/sr'}, {'sample': 'chrome'})
    """
    wrong = [name for name, value in about.items() if not isinstance(value, str)]
    if wrong:
        raise ArgumentError(f"{wrong[0]} must be a string, got {about[wrong[0]]!r:.60}")
    solid = solid_angles(rig)
    note = "4 A / r^2 for a distant camera: views that move the half vector at the peak as much as the kernel does"
    return {
        "format": "matcam measurement metadata",
        "version": 1,
        "quantity": {"name": "BRDF", "unit": "1/sr"},
        "receiver": {"solid_angle_sr": solid["equivalent_receiver_sr"], "meaning": note, **solid},
        "source": {"solid_angle_sr": solid["lamp_sr"], "half_angle_rad": float(rig.lamp_radius)},
        "instrument": rig.description(),
        "cell_value": rig.cell_value,
        "pixel_phase_px": rig.pixel_phase,
        "about": about,
    }


def effective_area(camera: Camera) -> float:
    """Compute the noise-equivalent area of the camera's kernel k, px^2.

    The area is 1 / integral of k^2 or, by Parseval's theorem, 1 / integral of the squared MTF over all frequencies. The
    area is 1 px^2 for a pixel of full fill factor without a lens. It is 4 pi sigma^2 for a Gaussian of standard
    deviation sigma, px.
    """
    frequency = np.linspace(0, 12.0, 6001)  # cycles/px
    angles = (np.arange(64) + 0.5) / 64 * np.pi / 4  # a square has eight such wedges
    squared = np.stack([np.asarray(camera.mtf(frequency, angle)) ** 2 for angle in angles])
    ring = 2 * np.pi * frequency * squared.mean(axis=0)
    # integrated over a ring, the squared transform of a bare pixel decreases as 1 / f^2: the integral beyond the last
    # frequency equals that over the last octave
    half = frequency >= frequency[-1] / 2
    beyond = np.trapezoid(ring[half], frequency[half])
    return float(1 / (np.trapezoid(ring, frequency) + beyond))
