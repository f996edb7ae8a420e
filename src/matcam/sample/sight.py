"""Lines of sight to a circle: the visible point, and the point whose normal is the half vector (docs/model.md 10)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from matcam.core.arrays import repeated, xp
from matcam.numerics.approximation import AnyValues

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import jax


def highlight_between(lamp_angle: jax.Array, camera: ArrayLike, lamp: ArrayLike) -> jax.Array:
    """Compute the angle between the optical axis and the normal at the highlight, rad, for a near camera or lamp.

    Args:
        lamp_angle: angle between lamp and optical axis, rad.
        camera: inverse of the distance of the camera, 1/radii.
        lamp: inverse of the distance of the lamp, 1/radii.
    """

    def miss(u: jax.Array) -> tuple[jax.Array, jax.Array]:
        view, view_slope = parallax(u, camera)
        light, light_slope = parallax(lamp_angle - u, lamp)
        return 2 * u + view - light - lamp_angle, 2 + view_slope + light_slope

    def newton(state: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
        u, low, high = state  # the root lies between low and high: a step outside is replaced by a bisection
        value, slope = miss(u)
        low, high = xp.where(value < 0, u, low), xp.where(value < 0, high, u)
        step = u - value / slope
        inside = (step >= low) & (step <= high)
        return xp.where(inside, step, (low + high) / 2), low, high

    ends = xp.minimum(0.0, lamp_angle), xp.maximum(0.0, lamp_angle)
    start = lamp_angle / 2 + 0 * (xp.asarray(camera) + lamp)  # a JAX array if one of the three is a JAX array
    return repeated(24, newton, (start, *(end + 0 * start for end in ends)))[0]


def parallax(aside: jax.Array, nearness: ArrayLike) -> tuple[jax.Array, jax.Array]:
    """Compute the parallax of a near point, rad, and the derivative of the parallax with respect to `aside`.

    The parallax is the angle between the directions to the point from the surface and from the centre of the sample.

    Args:
        aside: angle of the point from the normal, seen from the centre of the sample, rad.
        nearness: inverse of the distance of the point from the centre, 1/radii.
    """
    q = xp.asarray(nearness)
    slope = q * (xp.cos(aside) - q) / (1 + q**2 - 2 * q * xp.cos(aside))
    return xp.arctan2(q * xp.sin(aside), 1 - q * xp.cos(aside)), slope


def angle_on_circle(slope: jax.Array, tilt: jax.Array) -> jax.Array:
    """Solve sin u + tilt cos u = slope for the solution u nearest to 0, rad. The result is +-pi/2 without a solution."""
    lean = xp.arctan(tilt)  # the solution is the intersection of a line of sight with a circle
    sine = slope * xp.cos(lean)
    inside = xp.abs(sine) < 1
    return xp.where(inside, xp.arcsin(xp.where(inside, sine, 0.0)) - lean, xp.sign(slope) * xp.pi / 2)


def depth_of(slope: AnyValues, q: ArrayLike) -> tuple[AnyValues, AnyValues]:
    """Compute the depth of the visible point on a line of sight.

    The line of sight meets a circle of radius 1. The depth is cos t, where t is the angle between the optical axis and the
    normal at the point. The angle t follows from sin t = slope (1 - q cos t). The second result is a mask, True for lines
    of sight that meet the circle.

    Args:
        slope: distance between the line of sight and the optical axis at depth 0, radii.
        q: inverse of the distance of the camera, 1/radii.
    """
    square = slope**2
    root = 1 + square * (q**2 - 1)
    hits = root > 0
    return depth_from(square, xp.sqrt(xp.where(hits, root, 1.0)), q), hits


def depth_from(square: AnyValues, root: AnyValues, q: ArrayLike) -> AnyValues:
    """Compute the depth of `depth_of` from the squared slope, `square`, and `root` = sqrt(1 - (1 - q^2) slope^2)."""
    return (square * q + root) / (1 + square * q**2)
