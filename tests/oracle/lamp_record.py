"""What one pixel records under a lamp anywhere, by fixed Gauss-Legendre panels in the camera's own polar coordinates: truth for
near lamps, azimuths and discs (docs/model.md 10). GGX (Walter et al. 2007, (33), (34)) and Lambert, a Gaussian lens, a box
pixel, a sphere or a cylinder. F is each point's own, at its own angle between light and half vector.

Imports nothing of the package. Vectors stand in the sensor's axes: x right, y up, z to the camera. A sphere's normals are given
by their angle t from the optical axis and their azimuth phi about it: the limb is one t, and the terminator at every t two phi
in closed form. A cylinder's by their angle u across its axis and the height v along it. Panels shrink towards the
highlight, the limb and the terminator. A disc is the mean over its points, by a rule of its own. Every value is made with two
rules of different orders, which must agree.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.special import erfc


class Surface(NamedTuple):
    """Height-correlated Smith; fresnel: F of theta_d, rad; None: 1."""

    alpha: float
    diffuse: float = 0.0
    fresnel: Callable | None = None


class Rig(NamedTuple):
    """radius of the limb, px; distances of camera and lamp from the sample's centre, radii; lens and pixel, px; angular radius
    of the lamp's disc from the centre, rad; kind "sphere" or "cylinder"."""

    radius: float = 24.0
    distance: float = np.inf
    lamp_distance: float = np.inf
    sigma: float = 0.5
    half_width: float = 0.5
    lamp_radius: float = 0.0
    kind: str = "sphere"


def lamp_vectors(rig, lamp_angle, azimuth, rings=1, spokes=1):
    """Directions (n, 3) from the sample's centre to points of the lamp, their distances (n,) and shares (n,) of its light."""
    sin, cos = np.sin(lamp_angle), np.cos(lamp_angle)
    towards = np.array([sin * np.cos(azimuth), sin * np.sin(azimuth), cos])
    if rig.lamp_radius == 0:
        return towards[None], np.array([rig.lamp_distance]), np.ones(1)
    first = np.array([cos * np.cos(azimuth), cos * np.sin(azimuth), -sin])
    second = np.cross(towards, first)
    x, w = np.polynomial.legendre.leggauss(rings)
    s, w = (np.repeat(a, spokes) for a in ((1 + x) / 2, w / 2 / spokes))
    phi = np.tile(2 * np.pi * (np.arange(spokes) + 0.3) / spokes, rings)
    if np.isinf(rig.lamp_distance):  # evenly over a cap: its height is
        up = 1 - s * (1 - np.cos(rig.lamp_radius))
        aside = np.sqrt(1 - up**2)
    else:  # a flat disc that faces the centre
        up, aside = np.ones_like(s), np.sqrt(s) * np.tan(rig.lamp_radius)
    points = up[:, None] * towards + aside[:, None] * (np.cos(phi)[:, None] * first + np.sin(phi)[:, None] * second)
    length = np.linalg.norm(points, axis=1)
    return points / length[:, None], rig.lamp_distance * length, w / length**2


def record(x, y, lamp_angle, azimuth, surface, rig, disc=(1, 1), orders=(10, 14)):
    """Radiance at unit irradiance, 1/sr, that the pixel centred on (x, y) px records; the two rules agree to 2e-5 or 2e-8."""
    total = np.zeros(2)
    vectors, distances, shares = lamp_vectors(rig, lamp_angle, azimuth, *disc)
    for towards, distance, share in zip(vectors, distances, shares, strict=True):
        total += share * np.array([_under_point(x, y, towards, distance, surface, rig, order) for order in orders])
    assert abs(total[0] - total[1]) < max(2e-5 * total[1], 2e-8), (x, y, lamp_angle, azimuth, surface, rig, total)
    return total[1]


def recorded_cell(angles, azimuth, surface, rig, disc=(1, 1), orders=(12, 16)):
    """Mean of both ways of a cell over the irradiance, NaN below the horizon; each under the lamp that shows the cell's angles
    (theta_h, theta_d, phi_d). Vectors stand about the half vector and are turned to the sensor."""
    directions = []
    for phi in (angles[2], angles[2] + np.pi):
        normal = np.array([-np.sin(angles[0]) * np.cos(phi), np.sin(angles[0]) * np.sin(phi), np.cos(angles[0])])
        light, view = (np.array([side * np.sin(angles[1]), 0, np.cos(angles[1])]) for side in (1, -1))
        if min(normal @ light, normal @ view) <= 0:
            return np.nan
        axis, lamp = _far(normal, view, 1 / rig.distance), _far(normal, light, 1 / rig.lamp_distance)
        first = lamp - (lamp @ axis) * axis
        first /= np.linalg.norm(first)
        scale = rig.radius * np.sqrt(1 - 1 / rig.distance**2) / (1 - normal @ axis / rig.distance)
        x, y = scale * normal @ first, scale * normal @ np.cross(axis, first)
        x, y = x * np.cos(azimuth) - y * np.sin(azimuth), x * np.sin(azimuth) + y * np.cos(azimuth)
        irradiance = normal @ light / np.sum((lamp - normal / rig.lamp_distance) ** 2)
        lamp_angle = np.arccos(np.clip(lamp @ axis, -1, 1))
        directions.append(record(x, y, lamp_angle, azimuth, surface, rig, disc, orders) / irradiance)
    return np.mean(directions)


def recorded_line_cell(angles, surface, rig, disc=(1, 1), orders=(12, 16)):
    """One way of a cell of a cylinder's table over the irradiance: its normal lies across the axis, at the axis's height 0, and
    the lamp stands where the cell's angles want it."""
    theta_h, theta_d, phi = angles
    normal = np.array([-np.sin(theta_h) * np.cos(phi), np.sin(theta_h) * np.sin(phi), np.cos(theta_h)])
    light, view = (np.array([side * np.sin(theta_d), 0, np.cos(theta_d)]) for side in (1, -1))
    axis, lamp = _far(normal, view, 1 / rig.distance), _far(normal, light, 1 / rig.lamp_distance)
    across = normal - (normal @ axis) * axis
    size = np.linalg.norm(across)
    across = across / size if size > 1e-12 else np.array([1.0, 0, 0])
    along = np.cross(axis, across)
    x = rig.radius * np.sqrt(1 - 1 / rig.distance**2) * (normal @ across) / (1 - normal @ axis / rig.distance)
    irradiance = normal @ light / np.sum((lamp - normal / rig.lamp_distance) ** 2)
    lamp_angle, azimuth = np.arccos(np.clip(lamp @ axis, -1, 1)), np.arctan2(lamp @ along, lamp @ across)
    return record(x, 0.0, lamp_angle, azimuth, surface, rig, disc, orders) / irradiance


def _far(normal, towards, nearness):
    """Unit vector from the sample's centre to what is seen from the surface in a direction."""
    cos = normal @ towards
    return nearness * normal + (np.sqrt(1 - nearness**2 * (1 - cos**2)) - nearness * cos) * towards


def _under_point(x, y, towards, lamp_distance, surface, rig, order):
    q, w = 1 / rig.distance, 1 / lamp_distance
    reach = rig.half_width + 9 * rig.sigma
    nodes = (_sphere_nodes if rig.kind == "sphere" else _cylinder_nodes)(
        x, y, towards, q, w, surface, rig, reach, order
    )
    if nodes is None:
        return 0.0
    n, height, weight = nodes
    stretch = rig.radius * np.sqrt(1 - q**2)
    depth = 1 - q * n[2]
    point = np.stack([n[0], height, n[2]])
    view = np.stack([-q * point[0], -q * point[1], depth])
    length = np.sqrt((view**2).sum(0))
    view /= length
    light = towards[:, None] - w * point
    far = np.sqrt((light**2).sum(0))
    light /= far
    cos_i, cos_o = (light * n).sum(0), (view * n).sum(0)
    kernel = _kernel(stretch * point[0] / depth - x, rig) * _kernel(stretch * height / depth - y, rig)
    sent = _reflected(surface, n, light, view, cos_i, cos_o) / far**2
    lit = (cos_i > 0) & (cos_o > 0)
    return float(np.sum(np.where(lit, kernel * sent * stretch**2 * length / depth**3, 0.0) * weight))


def _sphere_nodes(x, y, towards, q, w, surface, rig, reach, order):
    """Normals (3, n), heights and weights under the kernel, lit and visible."""
    stretch = rig.radius * np.sqrt(1 - q**2)
    distance = np.hypot(x, y)
    corner = np.sqrt(2) * reach
    limb = np.arccos(q)
    first, last = (_angle_at(r, stretch, q, limb, rig.radius) for r in (max(distance - corner, 0), distance + corner))
    if first >= limb:
        return None
    a, psi = np.arctan2(np.hypot(*towards[:2]), towards[2]), np.arctan2(towards[1], towards[0])
    peak, half = _highlight(a, q, w), np.arccos(w)
    grades = surface.alpha * 3.0 ** np.arange(-1, 7)
    layers = np.array([1e-3, 0.01, 0.05, 0.2]) * (last - first)
    inner = [peak, *(peak - grades), *(peak + grades), *np.linspace(first, last, 9), *(last - layers)]
    turns = (
        abs(a - half),
        min(a + half, 2 * np.pi - a - half),
    )  # where a circle of one t begins and ends to be lit all round
    cuts = np.unique(
        np.clip([first, last, *turns, *inner, *(t + s * layers[0] for t in turns for s in (-1, 1))], first, last)
    )
    t, t_weight = _panels(cuts, order)
    centre = np.arctan2(y, x)
    spread = np.arcsin(corner / distance) if distance > corner else np.pi
    around = psi - centre  # of the lamp's side, from the pixel's
    around -= 2 * np.pi * np.round(around / (2 * np.pi))
    normals, weights = [], []
    for angle, weight in zip(t, t_weight, strict=True):
        bound = (w - np.cos(angle) * np.cos(a)) / max(np.sin(angle) * np.sin(a), 1e-300)
        if bound >= 1:
            continue
        lit = np.pi if bound <= -1 else np.arccos(bound)
        for shift in (-2 * np.pi, 0, 2 * np.pi):
            low, high = max(-spread, around + shift - lit), min(spread, around + shift + lit)
            if high <= low:
                continue
            width = np.hypot(surface.alpha, angle - peak) / max(np.sin(angle), 1e-3) * np.array([0.4, 1, 2.5, 6, 15])
            ends = np.array([1e-3, 0.01, 0.05, 0.2]) * (high - low)
            inside = [around + shift, *(around + shift - width), *(around + shift + width), *np.linspace(low, high, 9)]
            phi, phi_weight = _panels(np.unique(np.clip([*inside, *(low + ends), *(high - ends)], low, high)), order)
            phi = phi + centre
            sin, cos = np.sin(angle), np.cos(angle)
            normals.append(np.stack([sin * np.cos(phi), sin * np.sin(phi), cos + 0 * phi]))
            weights.append(weight * phi_weight * sin)
    if not normals:
        return None
    n = np.concatenate(normals, axis=1)
    return n, n[1], np.concatenate(weights)


def _cylinder_nodes(x, y, towards, q, w, surface, rig, reach, order):
    """The same of a cylinder along y; the lamp may stand anywhere. Limb and terminator are straight, along y."""
    stretch = rig.radius * np.sqrt(1 - q**2)
    across = np.hypot(towards[0], towards[2])
    limb, half, a = np.arccos(q), np.arccos(min(w / max(across, 1e-12), 1.0)), np.arctan2(towards[0], towards[2])
    low, high = max(a - half, -limb), min(a + half, limb)
    first, last = (np.sign(e) * _angle_at(abs(e), stretch, q, limb, rig.radius) for e in (x - reach, x + reach))
    first, last = max(first, low), min(last, high)
    if last <= first:
        return None
    mirror = _mirror_height(towards, q, w, low, high)
    here = (y + np.array([-1, 1]) * reach) * (1 - q * np.cos((first + last) / 2)) / stretch
    peak = _closest(np.clip(mirror, *here), towards, q, w, low, high)
    grades = surface.alpha * 3.0 ** np.arange(-1, 7)
    layers = np.array([1e-3, 0.01, 0.05, 0.2]) * (last - first)
    inner = [
        peak,
        *(peak - grades),
        *(peak + grades),
        *np.linspace(first, last, 25),
        *(first + layers),
        *(last - layers),
    ]
    u, u_weight = _panels(np.unique(np.clip(inner, first, last)), order)
    scale = stretch / (1 - q * np.cos(u))
    ends = (y + np.array([[-1], [1]]) * reach) / scale
    cuts = ends[0] + (ends[1] - ends[0]) * np.linspace(0, 1, 17 if w + q > 0 else 7)[:, None]
    if w + q > 0:  # the half vector turns along the axis, by half of what the sights do
        steps = 2 / (w + q) * surface.alpha * 3.0 ** np.arange(-1, 6)
        about = mirror + np.concatenate([-steps, [0], steps])
        cuts = np.concatenate([cuts, np.clip(about[:, None], *ends)])
    cuts = np.sort(cuts, axis=0).T
    unit, unit_weight = np.polynomial.legendre.leggauss(order)
    width = np.diff(cuts, axis=1)[..., None] / 2
    v = (cuts[:, :-1, None] + width * (1 + unit)).reshape(u.size, -1)
    weight = u_weight[:, None] * (width * unit_weight).reshape(u.size, -1)
    u = np.broadcast_to(u[:, None], v.shape).ravel()
    return np.stack([np.sin(u), 0 * u, np.cos(u)]), v.ravel(), weight.ravel()


def cylinder_mirror(lamp_angle, azimuth, rig):
    """Where a cylinder mirrors the lamp's centre, px; 0 along it where it does all along, or nowhere."""
    towards, q, w = (
        lamp_vectors(rig._replace(lamp_radius=0.0), lamp_angle, azimuth)[0][0],
        1 / rig.distance,
        1 / rig.lamp_distance,
    )
    limb, half, a = np.arccos(q), np.arccos(w / np.hypot(towards[0], towards[2])), np.arctan2(towards[0], towards[2])
    ends = max(a - half, -limb), min(a + half, limb)
    v = _mirror_height(towards, q, w, *ends)
    u = _closest(v, towards, q, w, *ends)
    scale = rig.radius * np.sqrt(1 - q**2) / (1 - q * np.cos(u))
    return scale * np.sin(u), scale * v


def _half_vector(u, v, towards, q, w):
    """Sum of the unit vectors to lamp and camera, at a place of a cylinder."""
    point = np.array([np.sin(u), v, np.cos(u)])
    view, light = np.array([0, 0, 1.0]) - q * point, towards - w * point
    return view / np.linalg.norm(view) + light / np.linalg.norm(light)


def _closest(v, towards, q, w, low, high):
    """The u at which the normal is closest to the half vector, at a height of a cylinder."""

    def aside(u):
        half = _half_vector(u, v, towards, q, w)
        return half[0] * np.cos(u) - half[2] * np.sin(u)

    if aside(low) <= 0 or aside(high) >= 0:
        return low if aside(low) <= 0 else high
    return brentq(aside, low, high, xtol=1e-14)


def _mirror_height(towards, q, w, low, high):
    """The height at which a cylinder mirrors the lamp; 0 where it does all along, or nowhere."""
    if q + w == 0 or towards[1] == 0:
        return 0.0

    def climb(v):
        return np.sign(towards[1]) * _half_vector(_closest(v, towards, q, w, low, high), v, towards, q, w)[1]

    end = np.sign(towards[1])
    while climb(end) > 0 and abs(end) < 1e6:
        end *= 2
    return brentq(climb, 0, end, xtol=1e-12) if climb(end) < 0 else end


def _angle_at(r, stretch, q, limb, radius):
    """Angle t of the normal that the picture shows at r px from the axis; the limb's beyond it."""
    return limb if r >= radius else brentq(lambda t: stretch * np.sin(t) - r * (1 - q * np.cos(t)), 0, limb, xtol=1e-15)


def _highlight(a, q, w):
    """Angle t of the normal halfway between lamp and camera."""

    def miss(t):
        view = np.arctan2(q * np.sin(t), 1 - q * np.cos(t))
        light = np.arctan2(np.sin(a) - w * np.sin(t), np.cos(a) - w * np.cos(t))
        return 2 * t + view - np.mod(light + 1e-9, 2 * np.pi) + 1e-9

    return 0.0 if a < 1e-12 else brentq(miss, 0, a, xtol=1e-14)


def _panels(cuts, order):
    unit, weight = np.polynomial.legendre.leggauss(order)
    half = np.diff(cuts)[:, None] / 2
    return (cuts[:-1, None] + half * (1 + unit)).ravel(), (half * weight).ravel()


def _kernel(x, rig):
    unit, x = np.sqrt(2) * rig.sigma, np.abs(x)
    return (erfc((x - rig.half_width) / unit) - erfc((x + rig.half_width) / unit)) / (4 * rig.half_width)


def _reflected(surface, normal, light, view, cos_i, cos_o):
    """F D G / 4 + diffuse cos_i cos_o / pi."""
    half = view + light
    f = 1.0
    if surface.fresnel is not None:
        f = surface.fresnel(np.arctan2(np.sqrt(((light - view) ** 2).sum(0)), np.sqrt((half**2).sum(0))))
    cross = np.cross(half, normal, axis=0)
    tan2 = (cross**2).sum(0) / (half * normal).sum(0) ** 2
    a = surface.alpha
    d = (a * (1 + tan2) / (a**2 + tan2)) ** 2 / np.pi
    lambdas = [np.sqrt(1 + a**2 * (1 / np.maximum(c, 1e-150) ** 2 - 1)) / 2 - 0.5 for c in (cos_i, cos_o)]
    return f * d / (1 + sum(lambdas)) / 4 + surface.diffuse * cos_i * cos_o / np.pi
