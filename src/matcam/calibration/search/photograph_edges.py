"""All slanted edges of a photograph, found and measured, colour by colour; and what they tell of the picture as a whole."""

from __future__ import annotations

from collections import Counter

import numpy as np

from matcam.calibration.edge.edge import AT_ONCE, EdgeSettings, edge_stack
from matcam.calibration.edge.edge_result import EdgeStack
from matcam.calibration.photograph.linear_image import LinearImage
from matcam.calibration.photograph.region import flaws
from matcam.calibration.search.edge_search import FoundEdges
from matcam.calibration.search.strips import regions_in_even_light, strip_regions, strips_along
from matcam.core.errors import FitError
from matcam.core.remark import Remark

_SATURATED = 0.02  # share of a strip's samples
_CONTRAST = 0.2  # (bright - dark) / (bright + dark), below which it is said
_DIRECTIONAL, _SIGNIFICANT = 0.15, 5.0  # of the blur's variance; standard deviations
_FEW = 6  # edges, below which nothing is said of directions


def found_edge_stack(
    plane: LinearImage, edges: FoundEdges, half_width: float = 0.5, *, accept_sharpened: bool = False
) -> EdgeStack:
    """Measure the edges that were found, in one plane.

    Long ones are measured in pieces. half_width: px, of the pixel. FitError where no edge can be measured, with the
    commonest reason.
    """
    strips = strips_along(edges, plane.shape)
    if not strips.u.size:
        raise FitError(
            f"no slanted edge was found ({edges.x.size} edges without room round them): photograph a chart of slanted squares "
            "(matcam chart)"
        )
    regions, saturated = zip(*strip_regions(strips, plane, AT_ONCE), strict=True)
    known = [
        [
            Remark("saturated", f"saturated: {share:.0%} of its samples") if share > _SATURATED else flaw
            for share, flaw in zip(shares, flaws(rows.value), strict=True)
        ]
        for rows, shares in zip(regions, saturated, strict=True)
    ]
    settings = EdgeSettings(half_width=half_width, accept_sharpened=accept_sharpened)
    result = edge_stack(zip(regions_in_even_light(regions), known, strict=True), settings)
    problems = [problem for problem in result.problems if problem]
    if len(problems) == len(result):
        code, count = Counter(problem.code for problem in problems).most_common(1)[0]
        example = next(problem for problem in problems if problem.code == code)
        raise FitError(f"none of its {len(result)} edges can be measured; {count} of them because: {example}")
    return result


def edge_remarks(result: EdgeStack, channel: str) -> list[Remark]:
    """Return what the edges of one channel say of their picture."""
    good = result.good
    codes = Counter(problem.code for problem in result.problems if problem)
    remarks = []
    for code, text in (
        ("saturated", "are saturated, and left out: expose less"),
        ("sharpened", "overshoot as sharpened ones do, and are left out"),
    ):
        if codes[code]:
            remarks.append(Remark(f"{code}-edges", f"{channel}: {codes[code]} of {len(result)} edges {text}"))
    dark, bright = result.dark[good], result.bright[good]
    contrast = float(np.median((bright - dark) / (np.abs(bright) + np.abs(dark))))
    if contrast < _CONTRAST:
        text = f"contrast is only {contrast:.0%}: errors are large; use a darker print or less stray light"
        remarks.append(Remark("low-contrast", f"{channel}: {text}"))
    if text := _directional_blur(result):
        remarks.append(Remark("directional-blur", f"{channel}: {text}"))
    return remarks


def _directional_blur(result: EdgeStack) -> str:
    """Return how the blur depends on direction, as motion makes it.

    Empty if it does not.
    """
    good = result.good
    if good.size < _FEW:
        return ""
    sigma, angle = result.parametric.values[good, 0], result.angle[good]
    weight = 1 / (4 * sigma**2 * result.parametric.covariance[good, 0, 0])
    # the second harmonic of the blur's variance
    design = np.stack([np.ones_like(angle), np.cos(2 * angle), np.sin(2 * angle)], 1)
    normal = design.T @ (weight[:, None] * design)
    # squares have two directions only, which leave one combination of the harmonics open: that is taken for 0
    inverse = np.linalg.pinv(normal, rcond=1e-3, hermitian=True)
    found = inverse @ (design.T @ (weight * sigma**2))
    left = weight * (sigma**2 - design @ found) ** 2
    covariance = inverse * max(1.0, left.sum() / max(good.size - 3, 1))
    size = float(np.hypot(found[1], found[2]))
    std = float(np.sqrt(found[1:] @ covariance[1:, 1:] @ found[1:]) / max(size, 1e-30))
    if size < _DIRECTIONAL * found[0] or size < _SIGNIFICANT * std:
        return ""
    most, least = np.sqrt(found[0] + size), np.sqrt(max(found[0] - size, 0.0))
    along = np.degrees(np.arctan2(found[2], found[1]) / 2) % 180
    blur = f"blur is {most:.2f} px along {along:.0f} degrees and {least:.2f} px across"
    return f"{blur}: the camera moved, or the lens is astigmatic"
