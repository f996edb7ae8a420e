"""Lateral colour: the difference in image size between two colours, from edges that were measured in both.

An edge determines its position along its normal only. Between colours it moves by a shift, and by a magnification that
may change with the squared distance from the centre of the image.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from matcam.calibration.camera.evidence import EdgeTable
from matcam.core.remark import Remark
from matcam.numerics.normal import robust_fit

_SAME = 2.0  # px: largest distance between the centres of one edge in two colours
_SAME_DIRECTION = np.radians(3.0)  # largest angle between their normals
_FEWEST, _MANY = 12, 24  # fewest edges for a magnification, and for one that changes over the field
_REMARKABLE, _SURE = 0.1, 5.0  # px in the corners, and standard deviations


class LateralColour(NamedTuple):
    """Size of the image in one colour relative to another.

    Attributes:
        corner: how far further out this colour lies in the image's corners, px.
        corner_std: its standard deviation, px.
        scale: the same over half the diagonal, at the middle (no unit).
        scale_std: its standard deviation.
        edges: how many edges say so (no unit).

    Example:
        >>> lateral = matcam.calibration.LateralColour(0.4, 0.02, 2e-4, 1e-5, 60)
        >>> lateral.corner
        0.4
    """

    corner: float
    corner_std: float
    scale: float
    scale_std: float
    edges: int


def lateral_colour(of: EdgeTable, reference: EdgeTable, shape: tuple[int, int]) -> LateralColour | None:
    """Compare the edges of one colour with those of another, or return None if too few are seen in both.

    shape: height and width of the images, px.
    """
    middle, unit = (np.array(shape[::-1]) - 1) / 2, float(np.hypot(*shape) / 2)
    places, moved, normals = [], [], []
    for source in set(of.source) & set(reference.source):
        mine, theirs = of.of_source(source), reference.of_source(source)
        here, there = (np.column_stack([edges.x, edges.y]) for edges in (mine, theirs))
        far, nearest = cKDTree(there).query(here)
        angle = theirs.angle[nearest]
        same = (far < _SAME) & (np.abs(np.angle(np.exp(1j * (mine.angle - angle)))) < _SAME_DIRECTION)
        normal = np.column_stack([np.cos(angle), np.sin(angle)])[same]
        places.append(there[nearest][same])
        normals.append(normal)
        moved.append(((here - there[nearest])[same] * normal).sum(1))
    if sum(map(len, places)) < _FEWEST:
        return None
    at, normal, off = (np.concatenate(parts) for parts in (places, normals, moved))
    from_middle = (at - middle) / unit
    out = (from_middle * normal).sum(1)
    columns = [normal[:, 0], normal[:, 1], out]
    if len(off) >= _MANY:
        columns.append(out * (from_middle**2).sum(1))
    fit = robust_fit(np.column_stack(columns), off)
    covariance, corner = fit.covariance * fit.chi2, (np.arange(len(columns)) >= 2).astype(float)
    return LateralColour(
        float(corner @ fit.parameters),
        float(np.sqrt(corner @ covariance @ corner)),
        float(fit.parameters[2]) / unit,
        float(np.sqrt(covariance[2, 2])) / unit,
        int(fit.kept.sum()),
    )


def lateral_remark(found: LateralColour, channel: str, reference: str) -> Remark | None:
    """Return a remark if two colours differ in size by more than 0.1 px and 5 standard deviations, else None."""
    if abs(found.corner) < max(_REMARKABLE, _SURE * found.corner_std):
        return None
    where = "further out" if found.corner > 0 else "further in"
    text = (
        f"{channel} lies {abs(found.corner):.2f} +- {found.corner_std:.2f} px {where} than {reference} in the corners"
    )
    return Remark("lateral-colour", f"{text}: lateral colour")
