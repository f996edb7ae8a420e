"""Reflection of the bright field behind a sphere, which reduces the apparent radius of its dark disc."""

import numpy as np

from matcam.files.capture import Capture

_GRAZING = (4.0, 2.5)
"""Mean and spread of c for metals and glasses, whose Fresnel reflectance at a grazing angle g is exp(-c g)."""


def field_reach(capture: Capture) -> tuple[float, float]:
    """Return the specified extent of the bright field beyond the limb, and its standard deviation, rad."""
    beyond = float(np.radians(capture.settings["outline"]["field_beyond_deg"]))
    return beyond, beyond / 3


def grazing_reflection(radius: float, reach: tuple[float, float] | None) -> tuple[float, float]:
    """Compute the shrinkage of a dark disc by the mirrored backlight, and its standard deviation, px.

    A ray that meets the sphere at a distance t inside the limb is deflected by 2 sqrt(2 t / radius). A field that
    extends by the angle E beyond the limb is therefore mirrored up to t = radius (1 - cos(E / 2)). The shrinkage is the
    integral of the Fresnel reflectance over this range of t.

    Args:
        radius: radius of the limb, px.
        reach: E and its standard deviation, rad; None: unknown.

    Example:
        >>> shrunk, std = grazing_reflection(400.0, (np.radians(5), np.radians(1)))
        >>> round(shrunk, 2), round(std, 2)
        (0.34, 0.13)
    """
    if reach is None:
        # the reflection of an assumed field of 3 degrees is not subtracted, but included in the error
        return 0.0, grazing_reflection(radius, (np.radians(3.0), 0.0))[0]
    angle, angle_std = reach

    def shrunk(edge: float, slope: float) -> float:
        # t = radius (1 - cos(g)), where g is the grazing angle, so dt = radius sin(g) dg
        g = np.linspace(0, edge / 2, 201)
        return float(radius * np.trapezoid(np.sin(g) * np.exp(-slope * g), g))

    here = shrunk(angle, _GRAZING[0])
    by_slope = (shrunk(angle, _GRAZING[0] - _GRAZING[1]) - shrunk(angle, _GRAZING[0] + _GRAZING[1])) / 2
    by_reach = (shrunk(angle + angle_std, _GRAZING[0]) - shrunk(max(angle - angle_std, 0.0), _GRAZING[0])) / 2
    return here, float(np.hypot(by_slope, by_reach))
