"""Refusal of mosaics that are declared as grey images."""

from __future__ import annotations

from matcam.calibration.photograph.linear_image import LinearImage
from matcam.core.errors import FitError
from matcam.numerics.alternation import alternation


def refuse_unnamed_mosaic(plane: LinearImage) -> None:
    if plane.channel == "grey" and plane.cfa is None and (share := alternation(plane.values)) > 0:
        raise FitError(
            f"alternate pixels differ by {share:.0%}, as in a colour mosaic that is read as grey: if the image is a mosaic, "
            "give cfa (the colours of its first 2 x 2 px)"
        )
