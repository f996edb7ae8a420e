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
from matcam.calibration.search.edge_search import EdgePlaces, clear_distance
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
    found = sides.found
    some = found.sum(1) >= _FEWEST
    seen, known = np.where(found[..., None], sides.seen, 0.0)[some], found[some][..., None]
    count = known.sum(1)
    middle = seen.sum(1) / count
    off = np.where(known, seen - middle[:, None], 0.0)
    # the direction of largest scatter is that of the side
    xx, yy, xy = (off[..., 0] ** 2).sum(1), (off[..., 1] ** 2).sum(1), (off[..., 0] * off[..., 1]).sum(1)
    turn = np.arctan2(2 * xy, xx - yy) / 2 + np.pi / 2
    outwards = np.where(known, sides.normal[some], 0.0).sum(1)
    turn = np.where(np.cos(turn) * outwards[:, 0] + np.sin(turn) * outwards[:, 1] < 0, turn + np.pi, turn)
    across = off[..., 0] * np.cos(turn)[:, None] + off[..., 1] * np.sin(turn)[:, None]
    good = np.sqrt((across**2).sum(1) / count[:, 0]) < _STRAIGHT
    # positions that were not found do not affect the centre
    length = np.where(good, sides.length[some], 0.0)
    x, y, angle = middle[good, 0], middle[good, 1], np.angle(np.exp(1j * turn[good]))
    clear, step = clear_distance(smooth, x, y, angle, length[good])
    length = length[good] - 2 * _CORNER
    order = np.argsort(-step * length, kind="stable")
    order = order[(clear > 0)[order]]
    return EdgePlaces(*(column[order] for column in (x, y, angle, length, clear.astype(float))))
