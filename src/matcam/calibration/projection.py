"""Where a chart's page lies in a picture, as the estimators of its targets take it: a `Registration`, or anything like it."""

from __future__ import annotations

from collections.abc import Callable

from matcam.calibration.chart import Element
from matcam.calibration.wave_fit import Array
from matcam.errors import ArgumentError

Projection = Callable[[Array], Array]
"""mm on the page (n, 2) -> px in the picture (n, 2)."""


def check_given(name: str, element: Element | None, projection: Projection | None) -> None:
    """ArgumentError where a chart's element, the argument `name`, comes without a projection, or a projection without it."""
    if (element is None) != (projection is None):
        raise ArgumentError(f"{name} and projection must be given together, or neither")
