"""Lateral colour: the difference in image size between two colours, from edges that were measured in both colours.

An edge determines a displacement along its normal only. The displacement between two colours is modelled as a shift and
a magnification, which may change with the squared distance from the centre of the image.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from matcam.calibration.camera.evidence import EdgeTable
from matcam.calibration.chart.registration import FEWEST_POSITIONS
from matcam.core.remark import Remark
from matcam.numerics.normal import SIGNIFICANT, robust_fit


class LateralColour(NamedTuple):
    """Size of the image in one colour relative to a reference colour.

    Attributes:
        corner: outward displacement of this colour relative to the reference in the corners of the image, px.
        corner_std: standard deviation of `corner`, px.
        scale: relative difference in magnification at the middle of the image (no unit).
        scale_std: standard deviation of `scale` (no unit).
        edges: number of edges that were used (no unit).

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
    """Estimate the lateral colour from the edges of two colours.

    The result is None if fewer than 12 edges were measured in both colours. `shape` is the height and width of the images, px.
    """
    middle, unit = (np.array(shape[::-1]) - 1) / 2, float(np.hypot(*shape) / 2)
    positions, moved, normals = [], [], []
    for source in set(of.source) & set(reference.source):
        mine, theirs = of.of_source(source), reference.of_source(source)
        here, there = (np.column_stack([edges.x, edges.y]) for edges in (mine, theirs))
        far, nearest = cKDTree(there).query(here)
        angle = theirs.angle[nearest]
        # In two colours, the centres of one edge are less than 2 px apart, and its normals less than 3 degrees.
        same = (far < 2) & (np.abs(np.angle(np.exp(1j * (mine.angle - angle)))) < np.radians(3.0))
        normal = np.column_stack([np.cos(angle), np.sin(angle)])[same]
        positions.append(there[nearest][same])
        normals.append(normal)
        moved.append(((here - there[nearest])[same] * normal).sum(1))
    if sum(map(len, positions)) < FEWEST_POSITIONS:
        return None
    at, normal, off = (np.concatenate(parts) for parts in (positions, normals, moved))
    from_middle = (at - middle) / unit
    out = (from_middle * normal).sum(1)
    columns = [normal[:, 0], normal[:, 1], out]
    # A magnification that changes over the field requires twice as many edges.
    if len(off) >= 2 * FEWEST_POSITIONS:
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
    """Create a remark if two colours are displaced by at least 0.1 px and 5 standard deviations in the corners of the image.

    Otherwise the result is None.
    """
    if abs(found.corner) < max(0.1, SIGNIFICANT * found.corner_std):
        return None
    where = "further out" if found.corner > 0 else "further in"
    return Remark(
        "lateral-colour",
        f"{channel} lies {abs(found.corner):.2f} ± {found.corner_std:.2f} px {where} than {reference} in the corners of the "
        "image, because of lateral colour",
    )
