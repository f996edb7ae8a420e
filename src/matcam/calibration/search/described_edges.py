"""The edges of a chart that was found: the sides of its squares only.

Around gratings, stars, dots and tables there are edges by the hundred. A described side is searched at the position
from the registration, and measured only if the areas on both sides of it are even: a side that is partly covered is
left out.
"""

from __future__ import annotations

import numpy as np

from matcam.calibration.chart.chart import Chart
from matcam.calibration.chart.registration import Projection
from matcam.calibration.chart.sides import seen_sides
from matcam.calibration.photograph.linear_image import smoothed
from matcam.calibration.search.edge_search import EdgePlaces, clear_edges, moments
from matcam.core.arrays import FloatArray

_CORNER = 3.5  # px that are cut off both ends of a side
_FEWEST = 5  # number of positions along a side at which it must be found
_STRAIGHT = 0.7  # px: largest distance of these from a straight line


def described_edges(values: FloatArray, chart: Chart, projection: Projection) -> EdgePlaces | None:
    """Return the sides of a chart's squares that can be measured; None for a chart without squares.

    values: (height, width) any monotone codes, mosaics balanced; NaN where there are no data. projection: from the page, mm, to
    the picture, px.
    """
    smooth = smoothed(values)
    sides = seen_sides(smooth, chart, projection)
    if sides is None:
        return None
    found = sides.found & (sides.found.sum(1) >= _FEWEST)[:, None]
    square, place = np.nonzero(found)
    some, one = np.unique(square, return_inverse=True)
    (x, y), (nx, ny) = sides.seen[square, place].T, sides.normal[square, place].T
    x, y, angle, _, width = moments(one, some.size, x, y, nx, ny, np.ones(one.size))[0].T
    good = width < np.sqrt(12) * _STRAIGHT
    return clear_edges(smooth, x[good], y[good], angle[good], sides.length[some[good]], _CORNER)
