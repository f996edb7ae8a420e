"""Rendered spheres beside each other, on one scale."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from matcam import srgb
from matcam.figures.style import GREY, styled


def spheres_figure(pictures: Mapping[str, np.ndarray], light: str, exposure: float = 1.0) -> Figure:
    """Linear radiances (size, size, 3) by their titles, encoded for display (sRGB) at one exposure: radiance 1 / exposure is
    white, and what is brighter stays white. light: what they are lit by, in words."""
    with styled():
        figure = Figure(figsize=(3.6 * len(pictures), 4.15), layout="constrained")
        for axes, (title, picture) in zip(
            figure.subplots(1, len(pictures), squeeze=False)[0], pictures.items(), strict=True
        ):
            axes.imshow(srgb.encoded(np.clip(picture * exposure, 0, 1)), interpolation="nearest")
            axes.set_title(title)
            axes.set_axis_off()
        figure.supxlabel(f"{light}; white: radiance {1 / exposure:.3g}", fontsize=8.5, color=GREY)
    return figure
