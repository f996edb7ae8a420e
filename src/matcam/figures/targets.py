"""What a chart's targets say of the MTF, side by side."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from matcam.calibration.mtf_samples import MTFSamples
from matcam.camera.camera import Camera
from matcam.figures.style import BLACK, BLUE, GREEN, GREY, ORANGE, VERMILION, nyquist_line, styled

_LOOKS = {
    "star": (BLUE, "o", "Siemens star"), "grating": (VERMILION, "s", "gratings"), "dots": (GREEN, "^", "dots"),
    "edge": (ORANGE, "D", "edges"),
}  # fmt: skip


def targets_figure(samples: Sequence[MTFSamples], camera: Camera | None = None, title: str = "") -> Figure:
    """MTF of lens and pixel by frequency, with error bars, of every kind of target; camera: to compare them with, then with
    what they leave, in their standard deviations."""
    with styled():
        figure = Figure(figsize=(9.2, 4.2), layout="constrained")
        axes, left = figure.subplots(1, 2, width_ratios=(1.5, 1)) if camera is not None else (figure.subplots(), None)
        axes.axhline(0, color=BLACK, lw=0.6)
        nyquist_line(axes)
        highest = max(float(s.frequency.max()) for s in samples)
        if camera is not None:
            f = np.linspace(0, highest, 200)
            along, diagonal = np.asarray(camera.mtf(f, 0.0)), np.asarray(camera.mtf(f, np.pi / 4))
            axes.fill_between(f, along, diagonal, color=GREY, alpha=0.4, lw=0.8, label="camera, all directions")
        for kind, (colour, mark, name) in _LOOKS.items():
            some = [s for s in samples if s.kind == kind]
            if not some:
                continue
            f, mtf, std, direction = (
                np.concatenate([getattr(s, n) for s in some]) for n in ("frequency", "mtf", "mtf_std", "direction")
            )
            axes.errorbar(f, mtf, yerr=std, fmt=mark, ms=3.5, lw=0.9, color=colour, label=name)
            if camera is not None and left is not None:
                left.plot(f, (mtf - np.asarray(camera.mtf(f, direction))) / std, mark, ms=3.5, color=colour)
        axes.set(
            xlabel="frequency [cycles/px]",
            ylabel="MTF of lens and pixel [-]",
            xlim=(0, highest * 1.02),
            ylim=(-0.1, 1.05),
        )
        axes.legend(loc="upper right")
        axes.set_title(title or "MTF", loc="left")
        if left is not None:
            left.axhline(0, color=BLACK, lw=0.6)
            left.axhspan(-1, 1, color=GREY, alpha=0.2, lw=0)
            left.set(xlabel="frequency [cycles/px]", ylabel="target less camera / standard deviation [-]")
            left.set_title("What they leave", loc="left")
    return figure
