"""Outline and highlights after removal of the distortion of the lens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from matcam.acquisition.highlights import Highlight
from matcam.acquisition.mirror_ball import MirrorBall
from matcam.camera.lens_field import LensField


def undistorted_sphere(
    field: LensField | None, ball: MirrorBall, centres: np.ndarray | None, highlights: Sequence[Highlight | None]
) -> tuple[MirrorBall, np.ndarray | None, list[Highlight | None]]:
    if field is None or (field.k1.value == 0 and field.k2.value == 0):
        return ball, centres, list(highlights)
    column, row, radius = field.true_circle(ball.column, ball.row, ball.radius)
    true = MirrorBall(row, column, radius, ball.distance)
    if centres is not None:
        centres = np.array([field.true_circle(x, y, ball.radius)[:2] for x, y in centres])
    moved: list[Highlight | None] = []
    for one in highlights:
        if one is not None:
            column, row = map(float, field.true_position(one.column, one.row))
            normal = true.normals(row, column)
            # rounding may move a highlight on the limb off the sphere
            one = replace(one, row=row, column=column, normal=normal if np.isfinite(normal).all() else one.normal)
        moved.append(one)
    return true, centres, moved
