"""All slanted edges of a photograph, found and measured, colour by colour; and what they tell of the picture as a whole."""

from __future__ import annotations

from collections import Counter

import numpy as np

from matcam.calibration import region, stack
from matcam.calibration.edge_result import EdgeMTF
from matcam.calibration.edge_search import FoundEdges
from matcam.calibration.light import evened
from matcam.calibration.maximum_likelihood import Noise
from matcam.calibration.planes import Plane
from matcam.calibration.profiles import Gaussian
from matcam.calibration.strips import regions_of, strips_along
from matcam.errors import FitError

_SATURATED = 0.02  # share of a strip's samples
_CONTRAST = 0.2  # (bright - dark) / (bright + dark), below which it is said
_DIRECTIONAL, _SIGNIFICANT = 0.15, 5.0  # of the blur's variance; standard deviations
_FEW = 6  # edges, below which nothing is said of directions


def measured_edges(plane: Plane, edges: FoundEdges, half_width: float, *, accept_sharpened: bool) -> EdgeMTF:
    """The edges of one plane as a stack; long ones in pieces. FitError where there is none that could be measured, with the
    commonest reason."""
    strips = strips_along(edges, plane.photograph.values.shape[:2])
    if not strips.u.size:
        raise FitError(
            f"no slanted edge was found ({edges.x.size} edges without room round them): photograph a chart of slanted squares "
            "(matcam chart)"
        )
    unknown = Noise(np.float64(np.nan), np.float64(np.nan))

    full: list[np.ndarray] = []

    def read(y: np.ndarray, x: np.ndarray) -> np.ndarray:
        value, saturated = plane.values(y, x)
        full.append(saturated.mean((1, 2)))
        return value

    regions = list(regions_of(strips, read, plane.sites, stack.AT_ONCE))
    looked_at = []
    for rows, even, shares in zip(regions, evened(regions), full, strict=True):
        flaws = [
            f"saturated: {share:.0%} of its samples" if share > _SATURATED else flaw
            for share, flaw in zip(shares, region.flaws(rows.value), strict=True)
        ]
        looked_at.append((even, flaws))
    result = stack.measured(looked_at, "gaussian", Gaussian(), unknown, half_width, accept_sharpened=accept_sharpened)
    reasons = Counter(problem for problem in result.problems if problem)
    if len(reasons) and sum(reasons.values()) == len(result):
        kinds = Counter(problem.split(":")[0] for problem in result.problems)
        kind, count = kinds.most_common(1)[0]
        example = next(p for p in result.problems if p.startswith(kind))
        raise FitError(f"none of its {len(result)} edges can be measured; {count} of them because: {example}")
    return result


def remarks_on(result: EdgeMTF, channel: str) -> list[str]:
    """What a photographer should know of a picture, from its edges in one channel."""
    good = np.array([not problem for problem in result.problems])
    said = []
    saturated = sum("saturated" in problem for problem in result.problems)
    sharpened = sum("sharpened" in problem for problem in result.problems)
    if saturated:
        said.append(f"{channel}: {saturated} of {len(result)} edges are saturated, and left out: expose less")
    if sharpened:
        said.append(f"{channel}: {sharpened} of {len(result)} edges overshoot as sharpened ones do, and are left out")
    contrast = float(np.median(((result.bright - result.dark) / (np.abs(result.bright) + np.abs(result.dark)))[good]))
    if contrast < _CONTRAST:
        said.append(
            f"{channel}: contrast is only {contrast:.0%}: errors are large; use a darker print or less stray light"
        )
    if directional := _direction(result, good):
        said.append(f"{channel}: {directional}")
    return said


def _direction(result: EdgeMTF, good: np.ndarray) -> str:
    """Whether the blur depends on direction all over the picture, as motion makes it: its variance's second harmonic."""
    if good.sum() < _FEW:
        return ""
    sigma, angle = result.parametric.values[good, 0], result.angle[good]
    weight = 1 / (4 * sigma**2 * result.parametric.covariance[good, 0, 0])
    design = np.stack([np.ones_like(angle), np.cos(2 * angle), np.sin(2 * angle)], 1)
    normal = design.T @ (weight[:, None] * design)
    # squares have two directions only, which leave one combination of the harmonics open: that is taken for 0
    inverse = np.linalg.pinv(normal, rcond=1e-3, hermitian=True)
    found = inverse @ (design.T @ (weight * sigma**2))
    left = weight * (sigma**2 - design @ found) ** 2
    covariance = inverse * max(1.0, left.sum() / max(good.sum() - 3, 1))
    size = float(np.hypot(found[1], found[2]))
    std = float(np.sqrt(found[1:] @ covariance[1:, 1:] @ found[1:]) / max(size, 1e-30))
    if size < _DIRECTIONAL * found[0] or size < _SIGNIFICANT * std:
        return ""
    most, least = np.sqrt(found[0] + size), np.sqrt(max(found[0] - size, 0.0))
    along = np.degrees(np.arctan2(found[2], found[1]) / 2) % 180
    blur = f"blur is {most:.2f} px along {along:.0f} degrees and {least:.2f} px across"
    return f"{blur}: the camera moved, or the lens is astigmatic"
