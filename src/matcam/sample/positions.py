"""Image positions for many half and difference angles on a sphere or cylinder."""

from __future__ import annotations

import numpy as np

from matcam.core.jax import jax
from matcam.core.programs import kept_program
from matcam.numerics.blocks import in_blocks, in_calls
from matcam.sample.shape import Curved


def positions_of(
    sample: Curved,
    theta_h: np.ndarray,
    theta_d: np.ndarray,
    phi_d: np.ndarray,
    lamp_nearness: jax.Array | np.ndarray | None = None,
) -> tuple[np.ndarray, ...]:
    """Evaluate `Curved.position` for many angles.

    The results are x and y (px) and the lamp angle (rad), in the broadcast shape of the angles.
    """
    angles = np.broadcast_arrays(theta_h, theta_d, phi_d)
    rows, shape = tuple(angle.ravel() for angle in angles), angles[0].shape
    found = in_calls(_position_blocks, rows, sample, lamp_nearness) if rows[0].size else rows
    return tuple(a.reshape(shape) for a in found)


@kept_program
def _position_blocks(
    used: jax.Array, rows: tuple[jax.Array, ...], sample: Curved, lamp_nearness: jax.Array | None
) -> tuple[jax.Array, ...]:
    def block(angles: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        theta_h, theta_d, phi_d = angles
        return tuple(sample.position(theta_h, theta_d, phi_d, lamp_nearness))

    return in_blocks(block, used, rows)
