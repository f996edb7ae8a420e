"""Printed levels of a chart, measured with its tone patches.

The printed level of a patch is its brightness divided by the brightness of the paper next to it. Illumination and
vignetting cancel in this ratio. Printed greys are darker or brighter than described. The deviation is smooth:
ln(printed) is a nearly linear function of ln(described). This function is interpolated between the patches. It
determines the contrasts of stars and gratings.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from matcam.calibration.chart.chart import Chart, Dots, Element, Grating, Patch, Star
from matcam.calibration.chart.registration import Projection
from matcam.core import checks
from matcam.core.arrays import FloatArray
from matcam.core.remark import Remark

_FEWEST = 4
"""Smallest number of patches that determine the printed levels."""


@dataclass(frozen=True, eq=False)
class PrintedLevels:
    """Printed levels of the patches of a chart.

    Attributes:
        described: (n,) levels in the description of the chart, ascending.
        printed: (n,) levels in the photograph, relative to the paper.
        std: (n,) relative standard deviations of `printed`.
    """

    described: FloatArray
    printed: FloatArray
    std: FloatArray

    def __call__(self, level: FloatArray | float) -> FloatArray:
        at, known = np.log(np.append(self.described, 1.0)), np.log(np.append(self.printed, 1.0))
        wanted = np.log(np.maximum(np.asarray(level, float), 1e-4))
        curve = PchipInterpolator(at, known, extrapolate=False)
        slope = (known[1] - known[0]) / (at[1] - at[0])
        inside = curve(np.clip(wanted, at[0], at[-1]))
        return np.minimum(np.exp(inside + slope * np.minimum(wanted - at[0], 0.0)), 1.0)

    def remark(self, *, assumed: bool = False) -> Remark | None:
        """Create a remark if the print differs from the description, else return None.

        `assumed`: whether the tone curve is assumed. A wrong tone curve has the same effect as a different print.
        """
        was = 0.3  # a medium level
        became = float(self(was))
        if abs(np.log(became / was)) < 0.05:
            return None
        either = ", or the tone curve is not as assumed (--tone)" if assumed else ""
        text = f"the print differs from the description{either}: level {was:g} is printed as {became:.2f}; the contrasts were "
        text += "measured with the tone patches"
        return Remark("printed-levels", text)

    @property
    def contrast_std(self) -> float:
        """Relative standard deviation of a printed contrast."""
        # The illumination differs between patch and paper by 0.4 %.
        return float(np.hypot(0.004, np.median(self.std)))

    def of(self, element: Element) -> Element:
        """Replace the described levels of a target by the printed levels.

        The levels of a star or of a sine grating become the mean of the printed wave plus and minus the amplitude of
        its first harmonic. The dark level may then be negative.
        """
        if isinstance(element, Grating) and element.profile != "sine":
            return replace(element, dark=float(self(element.dark)), bright=float(self(element.bright)))
        if isinstance(element, Star | Grating):
            mean, amplitude = (element.bright + element.dark) / 2, (element.bright - element.dark) / 2
            sine = np.cos(2 * np.pi * np.arange(256) / 256)
            wave = self(mean + amplitude * sine)
            middle, first = float(wave.mean()), 2 * float((wave * sine).mean())
            return replace(element, dark=middle - first, bright=middle + first)
        return replace(element, level=float(self(element.level))) if isinstance(element, Dots) else element


def printed_levels(values: FloatArray, chart: Chart, projection: Projection) -> PrintedLevels | None:
    """Measure the printed levels of the tone patches of a chart; None if too few patches are usable.

    `values`: (height, width) linear values, NaN for missing pixels. `projection`: map from the page, mm, to the image,
    px.
    """
    rows = []
    for patch in checks.instance("chart", chart, Chart).elements:
        if isinstance(patch, Patch):
            found = _over_paper(values, patch, projection)
            if found is not None:
                rows.append((patch.level, *found))
    if len(rows) < _FEWEST:
        return None
    level, printed, std = np.array(sorted(rows)).T
    # The levels of a print change smoothly: a patch far from the line was covered, or lit differently from its paper.
    x, y = np.log(level), np.log(printed)
    slope = float(np.median(y[x < 0] / x[x < 0]))
    close = np.abs(y - slope * x) < 0.12 * np.maximum(np.abs(slope * x), 0.3)
    good = close & (np.append(True, np.diff(printed) > 0))
    if good.sum() < _FEWEST:
        return None
    return PrintedLevels(level[good], printed[good], std[good])


def _over_paper(values: FloatArray, patch: Patch, projection: Projection) -> tuple[float, float] | None:
    """Measure the level of a patch relative to the paper, with its relative standard deviation.

    The result is None if the patch or the paper is uneven, has no positive level, or has too few known pixels.
    """
    corners = np.array(patch.corners)
    centre, across, along = corners.mean(0), (corners[1] - corners[0]) / 2, (corners[3] - corners[0]) / 2
    line = np.linspace(-1, 1, 16)

    def level(u: FloatArray, v: FloatArray) -> tuple[float, float]:
        position = np.stack([a.ravel() for a in np.meshgrid(u, v)], axis=-1)
        at = np.rint(projection(centre + position[:, :1] * across + position[:, 1:] * along)).astype(int)
        at = np.unique(at, axis=0)
        at = at[((at >= 0) & (at < values.shape[::-1])).all(1)]
        seen = values[at[:, 1], at[:, 0]]
        seen = seen[np.isfinite(seen)]
        # A level requires at least 24 known pixels.
        return (float(seen.mean()), float(seen.std() / np.sqrt(seen.size))) if seen.size >= 24 else (np.nan, np.nan)

    middle, *ends = projection(np.array([centre, centre + across, centre + along]))
    shortest = max(min(float(np.hypot(*(end - middle))) for end in ends), 1e-9)
    # Blur affects the level within 3 px of the border of a patch, which are excluded: 0.3 to 0.6 of half its size.
    blurred = 3.0 / shortest
    inner = (1 - np.clip(blurred, 0.3, 0.6)) * line
    own, std = level(inner, inner)
    halves = np.array([level(half, inner) for half in np.split(inner, 2)])
    uneven = np.nan_to_num(np.abs(halves[:, 0] - own) - 3 * halves[:, 1]).max()
    # The distance to the paper is the same beyond the shorter and the longer sides.
    ratio = float(np.hypot(*across) / np.hypot(*along))
    # The paper begins 0.2 to 0.45 of half the size from the border of the patch; its measured width is 0.15.
    distance = np.clip(blurred, 0.2, 0.45) + np.linspace(0, 0.15, 8)
    u, v = 1 + distance * min(1.0, 1 / ratio), 1 + distance * min(1.0, ratio)
    paper = np.array([[level(u, inner)[0], level(-u, inner)[0]], [level(inner, v)[0], level(inner, -v)[0]]])
    best = int(np.argmax(np.nan_to_num(paper.mean(1))))
    mean, apart = float(paper[best].mean()), float(abs(np.subtract(*paper[best])) / paper[best].sum())
    # An even patch varies by at most 5 % beyond noise, and the paper on both sides by at most 5 %. NaN fails all comparisons.
    if not (own > 0 and mean > 0 and apart <= 0.05 and uneven <= 0.05 * own):
        return None
    return own / mean, float(np.hypot(std / own, 0.1 * apart))
