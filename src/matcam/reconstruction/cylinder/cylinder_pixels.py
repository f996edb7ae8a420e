"""Columns of the strips of a cylinder for a joint fit. Likelihood, prior and solver are those for a sphere."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from matcam.acquisition.merged_picture import MergedPicture
from matcam.forward.integral.blur import blur_of
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.reconstruction.cylinder.profile_model import ProfileModel
from matcam.reconstruction.cylinder.profile_rule import RowRule, chosen_columns, row_count
from matcam.reconstruction.cylinder.strips import Strip, StripProfiles
from matcam.reconstruction.joint.field_change import FieldChange
from matcam.reconstruction.joint.joint_problem import JointLayout, PixelModel
from matcam.reconstruction.observed_pixels import ObservedPixels
from matcam.reconstruction.picture_model import LampFrame
from matcam.reconstruction.picture_rule import lamp_positions
from matcam.reconstruction.sphere_scene import SphereScene, mirror_ball
from matcam.rigs import Rig
from matcam.sample.curved import Sphere


def cylinder_pixels(
    pictures: Sequence[MergedPicture],
    scene: SphereScene,
    frames: Sequence[LampFrame],
    layout: JointLayout,
    kind: LobeKind,
    p: np.ndarray,
    *,
    disc: bool = True,
    keep: Sequence[ObservedPixels] | None = None,
    strips: Sequence[Strip],
    profiles: dict[str, StripProfiles],
) -> tuple[PixelModel, list[ObservedPixels], list[FieldChange]]:
    """Choose the columns of each image for the fit, and build their model.

    The parameters are those of a sphere. The centre of an image is in the column of the axis, and in the row to which the
    directions to lamp and camera refer. `scene.radius` is half the width of the outline.

    `strips` are the strips of material. `profiles` contains the profiles of each image by the name of the image. The other
    arguments and the results are those of `sphere_pixels`.
    """
    width = float(np.exp(p[0]))
    alphas = (width, float(np.exp(p[1])) if kind.stretched else width)
    turns, weights, plateau = lamp_positions(scene.lamp_radius if disc else 0.0, min(alphas))
    balls = [mirror_ball(layout, p, k) for k in range(len(pictures))]
    count = max(row_count(strips, ball, one.base, far, alphas) for (ball, far), one in zip(balls, frames, strict=True))
    model = ProfileModel(
        kind=kind,
        blur=blur_of(Rig(scene.camera, Sphere(scene.radius))),
        positions=turns,
        weights=weights,
        turns=np.array([strip.turn for strip in strips]),
        rule=RowRule.of(strips, count),
    )
    pixels = []
    for k, picture in enumerate(pictures):
        ball, far = balls[k]
        last = None if keep is None else keep[k]
        pixels.append(
            chosen_columns(
                profiles[picture.name], strips, ball, frames[k].base, far, alphas, plateau=plateau, keep=last
            )
        )
    return model, pixels, []
