"""Small captures that several tests share, drawn once."""

from functools import cache

import numpy as np

from tests.oracle.capture import METALS, Drawn, Faults, Sensor, draw
from tests.oracle.sphere_picture import Surface, View

VIEW = View(radius=70.0, column=112.3, row=108.7, shape=(220, 220))
ANGLES = np.radians([10, 35, 55, 75])


def surface(name="Cr", alpha=0.02, family="ggx", power=1.0, diffuse=0.0):
    n, k = METALS[name]
    return Surface(family, alpha, power, n, k, (diffuse,))


@cache
def small(seed=1, clip="well", cfa="RGGB", peak_fill=0.8, within=0.0, reference="monitor"):
    """A capture of a rough chromium sphere, 4 lamp positions by 5 exposures of 220 x 220 px."""
    return draw(
        surface(),
        VIEW,
        ANGLES,
        sensor=Sensor(clip=clip, cfa=cfa),
        faults=Faults(shift_within=within),
        peak_fill=peak_fill,
        reference=reference,
        seed=seed,
    )


def changed(drawn, frames=None, rows=None, settings=None):
    """A copy with other parts."""
    return Drawn(
        dict(drawn.frames) if frames is None else frames,
        [dict(row) for row in drawn.rows] if rows is None else rows,
        drawn.settings if settings is None else settings,
        drawn.profile,
        drawn.truth,
    )
