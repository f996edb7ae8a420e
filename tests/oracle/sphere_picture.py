"""Whole pictures of a sphere under a near lamp: truth for what is read from photographs (docs/model.md 10).

GGX (Walter et al. 2007, (33), (34)) or EPD with height-correlated Smith masking, Fresnel's reflectance of n and k, a Lambertian
part; a Gaussian lens and a box pixel. Vectors: x right, y up, z to the camera; row 0 on top.

Imports nothing of the package. The light is split by a smooth window about the highlight's mirror normal:

- Inside, Gauss-Legendre panels on the sphere's own coordinates (angle from the optical axis and azimuth about it; the limb is
  where a panel ends), which shrink towards the highlight. Each node goes through the kernel's closed form.
- Along the limb, the same coordinates: panels across it, equal steps along it.
- Elsewhere, radiance on a regular grid of the sensor, 1 or 2 points a px as the place needs, through the same kernel.

`fine` multiplies both; a test doubles it.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.special import erf, gamma

_FLAT, _END = 6.0, 13.0  # px: where the window begins to fall, and where it ends
_RIM, _RIM_END = 2.0, 10.0  # px inside of the limb: where the ring begins to fade, and where it ends
_DENSE, _DENSE_RIM, _BLEND = 26.0, 14.0, 10.0  # px from highlight and limb with two points a px, and where it fades
_TILE = 20  # px
_CUT = 6.0  # standard deviations of the lens


class Surface(NamedTuple):
    """family "ggx" or "epd" (power: its exponent p); n, k and diffuse albedo: a number, or one for each channel. coat: index of
    a smooth layer over the diffuse part, which loses what that reflects; 1: none."""

    family: str = "ggx"
    alpha: float = 0.02
    power: float = 1.0
    n: tuple = (1.5,)
    k: tuple = (0.0,)
    diffuse: tuple = (0.0,)
    coat: float = 1.0


class View(NamedTuple):
    """radius of the limb, px; distances of camera and lamp from the centre, radii; lens and half pixel, px; the sphere's
    centre, which lies on the optical axis; picture's shape. k1: a place at r px from `axis` (px right of and above the sphere's
    centre) is seen at r (1 + k1 (r / radius)^2). growth: the lens is wider there by 1 + growth (r / radius)^2; it acts on
    highlight and limb, not where the picture is smooth."""

    radius: float = 350.0
    camera: float = 40.0
    lamp: float = 25.0
    sigma: float = 0.5
    half_width: float = 0.5
    column: float = 400.0
    row: float = 400.0
    shape: tuple = (800, 800)
    k1: float = 0.0
    axis: tuple = (0.0, 0.0)
    growth: float = 0.0


def _seen(x, y, view):
    """Where places are seen, by how much areas are magnified there, and the lens's width over sigma."""
    x, y = x - view.axis[0], y - view.axis[1]
    rho2 = (x**2 + y**2) / view.radius**2
    bent = 1 + view.k1 * rho2
    return x * bent + view.axis[0], y * bent + view.axis[1], bent * (1 + 3 * view.k1 * rho2), 1 + view.growth * rho2


def _unbent(x, y, view):
    """The places that are seen at x, y."""
    if not view.k1:
        return x, y
    x, y = x - view.axis[0], y - view.axis[1]
    at = x, y
    for _ in range(60):
        bent = 1 + view.k1 * (at[0] ** 2 + at[1] ** 2) / view.radius**2
        at = x / bent, y / bent
    return at[0] + view.axis[0], at[1] + view.axis[1]


def fresnel(cos, n, k):
    """Unpolarised reflectance of n + ik, from the complex Snell law."""
    eta = n + 1j * k
    below = np.sqrt(eta**2 - (1 - cos**2))
    parallel = (eta**2 * cos - below) / (eta**2 * cos + below)
    across = (cos - below) / (cos + below)
    return (np.abs(parallel) ** 2 + np.abs(across) ** 2) / 2


def direction(angle, azimuth):
    """Unit vector at an angle from the optical axis, turned from +x towards +y."""
    return np.array([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)])


def lamp_angle(theta_d, view):
    """Angle lamp-axis, seen from the centre, at which the mirror point's difference angle is theta_d, rad."""

    def miss(angle):
        t = mirror_angle(angle, view)
        return t + np.arctan2(q * np.sin(t), 1 - q * np.cos(t)) - theta_d

    q = 1 / view.camera
    return brentq(miss, 1e-9, np.arccos(q) + np.arccos(1 / view.lamp) - 1e-6, xtol=1e-13)


def mirror_angle(angle, view):
    """Angle from the axis of the normal halfway between lamp and camera, for a lamp `angle` off the axis (Alhazen)."""
    q, w = 1 / view.camera, 1 / view.lamp

    def miss(t):
        towards_camera = np.arctan2(-q * np.sin(t), 1 - q * np.cos(t))
        towards_lamp = np.arctan2(np.sin(angle) - w * np.sin(t), np.cos(angle) - w * np.cos(t))
        return t - (towards_camera + towards_lamp) / 2

    return 0.0 if angle < 1e-12 else brentq(miss, 0, angle, xtol=1e-15)


def picture(surface, view, towards, shift=(0.0, 0.0), fine=1):
    """Radiance (height, width, channels) at unit irradiance in the sphere's centre, 1/sr.

    towards: unit vector from the centre to the lamp. shift: of the sphere in this picture (columns, rows), px.
    """
    view = view._replace(column=view.column + shift[0], row=view.row + shift[1])
    channels = max(len(surface.n), len(surface.k), len(surface.diffuse))
    each = [np.broadcast_to(np.asarray(v, float), channels) for v in (surface.n, surface.k, surface.diffuse)]
    cosines = np.linspace(0, 1, 40001)
    curves = [fresnel(cosines, n, k) for n, k in zip(each[0], each[1], strict=True)]
    angle, azimuth = np.arctan2(np.hypot(*towards[:2]), towards[2]), np.arctan2(towards[1], towards[0])
    peak = mirror_angle(angle, view)
    window = _Window(view, peak, azimuth)
    lobe, body = _far(surface, view, towards, window, fine)
    _add_ring((lobe, body if any(np.ravel(surface.diffuse)) else None), surface, view, towards, window, fine)
    cos_d = _cos_d_of_pixels(view, towards)
    # F changes by less than 1e-4 over a pixel outside of the window: it is taken at the pixel's centre there
    image = np.stack(
        [lobe * np.interp(cos_d, cosines, f) + rho * body for f, rho in zip(curves, each[2], strict=True)], -1
    )
    _add_highlight(image, surface, view, towards, window, peak, azimuth, (cosines, curves, each[2]), fine)
    return image


class _Window:
    """Smooth share, 1 at the highlight, 0 from `_END` px on; by radius and arc, or by x and y close to the axis."""

    def __init__(self, view, peak, azimuth):
        self.rho = _sensor_radius(peak, view)
        self.azimuth, self.polar = azimuth, self.rho > 2 * _END
        self.x, self.y = self.rho * np.cos(azimuth), self.rho * np.sin(azimuth)

    def offsets(self, x, y):
        if not self.polar:
            return x - self.x, y - self.y
        turn = np.arctan2(y, x) - self.azimuth
        return np.hypot(x, y) - self.rho, self.rho * (turn - 2 * np.pi * np.round(turn / (2 * np.pi)))

    def share(self, x, y):
        total = 1.0
        for offset in self.offsets(x, y):
            total = total * _fading((np.abs(offset) - _FLAT) / (_END - _FLAT))
        return total


def _fading(s):
    """From 1 below 0 to 0 above 1, with three smooth derivatives."""
    s = np.clip(s, 0, 1)
    return 1 - s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3)


def _sensor_radius(t, view):
    q = 1 / view.camera
    return view.radius * np.sqrt(1 - q**2) * np.sin(t) / (1 - q * np.cos(t))


def _normals(x, y, view):
    """Normals (3, ...) that the picture shows at x, y px from the axis; those beyond the limb as on it."""
    q = 1 / view.camera
    stretch = view.radius * np.sqrt(1 - q**2)
    rho2 = x**2 + y**2
    clamp = np.minimum(1.0, view.radius * (1 - 1e-12) / np.sqrt(np.maximum(rho2, 1e-300)))
    slope2 = rho2 * clamp**2 / stretch**2
    n_z = (slope2 * q + np.sqrt(np.maximum(1 - slope2 * (1 - q**2), 0))) / (1 + slope2 * q**2)
    scale = clamp / stretch * (1 - q * n_z)
    return np.stack([x * scale, y * scale, n_z])


def _vectors(n, view, towards):
    """Unit vectors to lamp and camera, and the squared distance to the lamp in its distance from the centre."""
    q, w = 1 / view.camera, 1 / view.lamp
    column = (3,) + (1,) * (n.ndim - 1)
    light = np.reshape(towards, column) - w * n
    far2 = (light**2).sum(0)
    seen = np.reshape(np.array([0, 0, 1.0]), column) - q * n
    return light / np.sqrt(far2), seen / np.sqrt((seen**2).sum(0)), far2


def _cos_d_of_pixels(view, towards):
    rows, columns = np.arange(view.shape[0]), np.arange(view.shape[1])
    x, y = _unbent(*np.meshgrid(columns - view.column, view.row - rows), view)
    light, seen, _ = _vectors(_normals(x, y, view), view, towards)
    return np.sqrt(np.clip((1 + (light * seen).sum(0)) / 2, 0, 1))


def _light(n, surface, view, towards):
    """Radiance of lobe (F = 1) and of a white body, and cos theta_d."""
    light, seen, far2 = _vectors(n, view, towards)
    cos_i, cos_o = (light * n).sum(0), (seen * n).sum(0)
    lit = (cos_i > 0) & (cos_o > 0)
    cos_i, cos_o = np.maximum(cos_i, 1e-12), np.maximum(cos_o, 1e-12)
    half = light + seen
    along = (half * n).sum(0)
    tan2 = np.maximum((half**2).sum(0) - along**2, 0) / along**2
    small = tan2 < 1e-4  # |half|^2 - along^2 loses digits close to the highlight
    if small.any():
        tan2[small] = (np.cross(half[:, small], n[:, small], axis=0) ** 2).sum(0) / along[small] ** 2
    a = surface.alpha
    if surface.family == "ggx":
        d = ((1 + tan2) * a / (a**2 + tan2)) ** 2 / np.pi
        into, out = ((np.sqrt(c**2 + a**2 * (1 - c**2)) - c) / 2 for c in (cos_i, cos_o))  # cos Lambda
    else:
        p = surface.power
        d = p / (np.pi * a**2 * gamma(1 / p)) * np.exp(-((tan2 / a**2) ** p)) * (1 + tan2) ** 2
        s, values = _epd_masking(p)
        sines = [np.sqrt(np.maximum(1 - c**2, 1e-300)) for c in (cos_i, cos_o)]
        into, out = (
            np.interp(c / sin / a, s, values, right=0.0) * a * sin for c, sin in zip((cos_i, cos_o), sines, strict=True)
        )
    # D G / (4 cos_o), with both cosines brought into the denominator: finite at the limb
    lobe = d * cos_i / (4 * (cos_o * cos_i + cos_o * into + cos_i * out)) / far2
    cos_d = np.sqrt(np.clip((1 + (light * seen).sum(0)) / 2, 0, 1))
    body = cos_i / np.pi / far2
    if surface.coat != 1:
        for cos in (cos_i, cos_o):
            body = body * (1 - fresnel(cos, surface.coat, 0.0)) / (1 - fresnel(1.0, surface.coat, 0.0))
    return np.where(lit, lobe, 0.0), np.where(lit, body, 0.0), cos_d


@lru_cache
def _epd_masking(power):
    """s Lambda(s) of slopes of scale 1 over s = cot(theta): Smith's integral (docs/model.md 6) by Gauss-Legendre panels."""
    last = 30.0 ** (1 / (2 * power))
    s = last * np.linspace(0, 1, 3001) ** 2
    unit, weight = np.polynomial.legendre.leggauss(12)
    cuts = np.concatenate([[0], np.geomspace(1e-5, 1, 25)])
    x = (cuts[:-1, None] + np.diff(cuts)[:, None] / 2 * (1 + unit)).ravel()
    w = (np.diff(cuts)[:, None] / 2 * weight).ravel()
    r = s[:, None] + (1.3 * last - s[:, None]) * x
    density = power / (np.pi * gamma(1 / power)) * np.exp(-(r ** (2 * power)))
    ratio = np.where(r > 0, s[:, None] / np.where(r > 0, r, 1), 1)
    reach = np.sqrt(np.maximum(r**2 - s[:, None] ** 2, 0)) - s[:, None] * np.arccos(np.clip(ratio, 0, 1))
    return s, 2 * ((r * density * reach) @ w) * (1.3 * last - s)


def _kernel(x, view, wider=1.0):
    unit = np.sqrt(2) * view.sigma * wider
    return (erf((x + view.half_width) / unit) - erf((x - view.half_width) / unit)) / (4 * view.half_width)


def _reach(view):
    return int(np.ceil(view.half_width + _CUT * view.sigma * (1 + max(view.growth, 0))))


def _far(surface, view, towards, window, fine):
    """Lobe (F = 1) and white body outside of the window, (height, width) each."""
    height, width = view.shape
    margin = _reach(view)
    lobe, body = (np.zeros((height + 2 * (margin + _TILE), width + 2 * (margin + _TILE))) for _ in range(2))
    with_body = any(np.ravel(surface.diffuse))
    starts = [(r, c) for r in range(0, height, _TILE) for c in range(0, width, _TILE)]
    starts = np.array(starts)
    middle = starts + (_TILE - 1) / 2
    x, y = _unbent(middle[:, 1] - view.column, view.row - middle[:, 0], view)
    half = _TILE / np.sqrt(2) * (1 + 4 * abs(view.k1))
    rho = np.hypot(x, y)
    to_peak = np.hypot(x - window.x, y - window.y)
    inside = rho < view.radius + half
    slack = half + 1
    dense = inside & ((rho > view.radius - slack - _DENSE_RIM - _BLEND) | (to_peak < slack + _DENSE + _BLEND))
    sparse = inside & (rho - slack < view.radius - _DENSE_RIM) & (to_peak + slack > _DENSE)
    finer = 2 if view.sigma < 0.45 else 1
    for is_dense, which in ((True, dense), (False, sparse)):
        density = (2 if is_dense else 1) * fine * finer
        for chunk in np.array_split(np.flatnonzero(which), 1 + which.sum() // 60):
            if chunk.size:
                parts = lobe, body if with_body else None
                _add_tiles(*parts, starts[chunk], density, is_dense, surface, view, towards, window)
    cut = np.s_[margin : margin + height, margin : margin + width]
    return lobe[cut], body[cut]


def _add_tiles(lobe, body, starts, density, is_dense, surface, view, towards, window):
    margin = _reach(view)
    step = 1 / density
    at = (np.arange(_TILE * density) + 0.5) * step - 0.5  # px in the tile
    x = starts[:, 1, None, None] + at[None, None, :] - view.column
    y = view.row - starts[:, 0, None, None] - at[None, :, None]
    x, y = _unbent(*np.broadcast_arrays(x, y), view)
    rho = np.hypot(x, y)
    ring = _fading((view.radius - rho - _RIM) / (_RIM_END - _RIM))
    # grids of both densities fade into each other: a sum that ends at a border is not a good integral
    near = 1 - _fading((np.hypot(x - window.x, y - window.y) - _DENSE) / _BLEND)
    dense = 1 - near * (1 - _fading((view.radius - rho - _DENSE_RIM) / _BLEND))
    share = (1 - ring) * (1 - window.share(x, y)) * (dense if is_dense else 1 - dense)
    share = np.where(rho < view.radius, share, 0) * step**2
    used = share > 0
    if not used.any():
        return
    n = _normals(x[used], y[used], view)
    found = _light(n, surface, view, towards)
    out = np.arange(-margin, _TILE + margin)
    k = _kernel(out[:, None] - at[None, :], view)
    for frame, values in ((lobe, found[0]), (body, found[1])):
        if frame is None:
            continue
        whole = np.zeros(x.shape)
        whole[used] = values
        tiles = k @ (whole * share) @ k.T
        for (r, c), tile in zip(starts, tiles, strict=True):
            frame[r : r + len(out), c : c + len(out)] += tile


def _graded(low, high, core, largest):
    """Cuts of [low, high] about 0, from a quarter of `core` growing by 2 to `largest`."""
    ladder, size, at = [0.0], core / 4, 0.0
    while at < max(-low, high):
        at += min(size, largest)
        ladder.append(at)
        size *= 2
    ladder = np.array(ladder)
    cuts = np.concatenate([-ladder[::-1], ladder])
    return np.unique(np.concatenate([[low], cuts[(cuts > low) & (cuts < high)], [high]]))


def _panels(cuts, order):
    unit, weight = np.polynomial.legendre.leggauss(order)
    half = np.diff(cuts)[:, None] / 2
    return (cuts[:-1, None] + half * (1 + unit)).ravel(), (half * weight).ravel()


def _add_ring(frames, surface, view, towards, window, fine):
    """Add the light of the ring inside of the limb, but for the highlight's window."""
    q = 1 / view.camera
    stretch, limb = view.radius * np.sqrt(1 - q**2), np.arccos(q)
    cuts = [_angle(view.radius - r, view) for r in np.arange(0.5, _RIM_END + 0.5, 0.5 / fine)[::-1]]
    layers = limb - (limb - cuts[-1]) * np.array([0.5, 0.2, 0.07, 0.02])
    t, t_weight = _panels(np.concatenate([cuts, layers, [limb]]), 3)
    count = int(np.ceil(2 * np.pi * view.radius / min(0.4, view.sigma) * fine))
    margin = _reach(view)
    for turns in np.array_split(2 * np.pi * np.arange(count) / count, 1 + count // 1000):
        angle, phi = (a.ravel() for a in np.meshgrid(t, turns, indexing="ij"))
        n = np.stack([np.sin(angle) * np.cos(phi), np.sin(angle) * np.sin(phi), np.cos(angle)])
        depth = 1 - q * n[2]
        x, y = stretch * n[:2] / depth
        area = np.repeat(t_weight * np.sin(t), len(turns)) * 2 * np.pi / count * stretch**2 * (n[2] - q) / depth**3
        share = area * _fading((view.radius - np.hypot(x, y) - _RIM) / (_RIM_END - _RIM)) * (1 - window.share(x, y))
        lobe, body, _ = _light(n, surface, view, towards)
        lit = (share > 0) & ((lobe > 0) | (body > 0))
        if not lit.any():
            continue
        seen_x, seen_y, larger, wider = _seen(x[lit], y[lit], view)
        share[lit] *= larger
        column, row = view.column + seen_x, view.row - seen_y
        first = np.round(row).astype(int) - margin, np.round(column).astype(int) - margin
        out = np.arange(2 * margin + 1)
        down = _kernel(first[0][:, None] + out - row[:, None], view, wider[:, None])
        across = _kernel(first[1][:, None] + out - column[:, None], view, wider[:, None])
        kernel = (down[:, :, None] * across[:, None, :]).reshape(len(row), -1)
        height, width = (n + 2 * margin + 2 for n in view.shape)
        rows, columns = (
            np.clip(f[:, None] + out + margin + 1, 0, n - 1) for f, n in zip(first, (height, width), strict=True)
        )
        position = (rows[:, :, None] * width + columns[:, None, :]).ravel()
        for frame, light in zip(frames, (lobe, body), strict=True):
            if frame is not None:
                found = np.bincount(position, (kernel * (light * share)[lit, None]).ravel(), height * width)
                frame += found.reshape(height, width)[margin + 1 : -margin - 1, margin + 1 : -margin - 1]


def _add_highlight(image, surface, view, towards, window, peak, azimuth, colour, fine):
    q = 1 / view.camera
    stretch = view.radius * np.sqrt(1 - q**2)
    wide = max(surface.alpha * view.radius, 0.05)
    largest, order = min(1.0, 2 * view.sigma) / fine, 5
    if window.polar:
        limb = np.arccos(q)
        radii = _graded(-_END, min(_END, view.radius - window.rho), wide * np.cos(peak), largest) + window.rho
        cuts = np.array([limb if r >= view.radius * (1 - 1e-14) else _angle(r, view) for r in radii])
        if cuts[-1] == limb:
            cuts = np.unique([*cuts, *(limb - np.array([0.003, 0.01, 0.03, 0.06]))])
            cuts = cuts[cuts >= _angle(radii[0], view) - 1e-15]
        t, t_weight = _panels(cuts, order)
        phi, phi_weight = _panels(_graded(-_END, _END, wide, largest) / window.rho + azimuth, order)
        t, phi = (a.ravel() for a in np.meshgrid(t, phi, indexing="ij"))
        n = np.stack([np.sin(t) * np.cos(phi), np.sin(t) * np.sin(phi), np.cos(t)])
        depth = 1 - q * n[2]
        x, y = stretch * n[:2] / depth
        # dx dy = stretch^2 (n_z - q) / depth^3 d omega (docs/model.md 3)
        area = (t_weight[:, None] * phi_weight).ravel() * np.sin(t) * stretch**2 * (n[2] - q) / depth**3
    else:
        u, u_weight = _panels(_graded(-_END, _END, wide * np.cos(peak), largest), order)
        x, y = (a.ravel() for a in np.meshgrid(u + window.x, u + window.y, indexing="ij"))
        area = (u_weight[:, None] * u_weight).ravel()
        n = _normals(x, y, view)
    share = area * window.share(x, y)
    lobe, body, cos_d = _light(n, surface, view, towards)
    margin = _reach(view)
    seen_x, seen_y, larger, wider = _seen(x, y, view)
    share = share * larger
    columns, rows = view.column + seen_x, view.row - seen_y
    first = [max(int(np.floor(v.min())) - margin, 0) for v in (rows, columns)]
    last = [min(int(np.ceil(v.max())) + margin + 1, size) for v, size in zip((rows, columns), view.shape, strict=True)]
    down = _kernel(np.arange(first[0], last[0])[:, None] - rows, view, wider)
    across = _kernel(np.arange(first[1], last[1])[:, None] - columns, view, wider)
    cosines, curves, diffuse = colour
    for channel, (f, rho) in enumerate(zip(curves, diffuse, strict=True)):
        light = (lobe * np.interp(cos_d, cosines, f) + rho * body) * share
        image[first[0] : last[0], first[1] : last[1], channel] += (down * light) @ across.T


def _angle(r, view):
    q, stretch = 1 / view.camera, view.radius * np.sqrt(1 - 1 / view.camera**2)
    return brentq(lambda t: stretch * np.sin(t) - r * (1 - q * np.cos(t)), 0, np.arccos(q), xtol=1e-15)


def backlit(view, beyond, surface=None, shift=(0.0, 0.0), channel=0):
    """Share of the background's light in each pixel (height, width) of a sphere before a bright field.

    beyond: rad by which the field reaches beyond the limb. Seen at grazing, the sphere reflects it: normals whose mirrored ray
    meets the field carry its light times F.
    """
    view = view._replace(column=view.column + shift[0], row=view.row + shift[1])
    height, width = view.shape
    margin = _reach(view)
    image = np.zeros((height + 2 * (margin + _TILE), width + 2 * (margin + _TILE)))
    q = 1 / view.camera
    out = np.arange(-margin, _TILE + margin)
    for r in range(-_TILE, height + _TILE, _TILE):
        for c in range(-_TILE, width + _TILE, _TILE):
            near = np.hypot(c + (_TILE - 1) / 2 - view.column, r + (_TILE - 1) / 2 - view.row)
            if abs(near - view.radius) > 34:  # beyond 14 px from the limb all is dark, or bright
                continue
            density = 8
            step = 1 / density
            at = (np.arange(_TILE * density) + 0.5) * step - 0.5
            x, y = _unbent(*np.meshgrid(c + at - view.column, view.row - r - at), view)
            rho = np.hypot(x, y)
            outside = np.clip((rho - view.radius) / step + 0.5, 0, 1)
            if beyond > 0:
                n = _normals(x, y, view)
                cos_o = (n[2] - q) / np.sqrt(1 + q**2 - 2 * q * n[2])
                # the mirrored ray leaves the line of sight by 180 degrees - 2 theta_o
                grazing = np.pi / 2 - beyond / 2
                border = view.radius * np.sin(grazing)
                mirrored = np.clip((rho - border) / step + 0.5, 0, 1) - outside
                n_k = (
                    (surface.n[channel % len(surface.n)], surface.k[channel % len(surface.k)]) if surface else (1.5, 0)
                )
                outside = outside + np.maximum(mirrored, 0) * fresnel(np.clip(cos_o, 0, 1), *n_k)
            k = _kernel(out[:, None] - at[None, :], view)
            top, left = r + _TILE, c + _TILE
            if top >= 0 and left >= 0 and top + len(out) <= image.shape[0] + 0 and left + len(out) <= image.shape[1]:
                image[top : top + len(out), left : left + len(out)] += k @ (outside * step**2) @ k.T
    cut = np.s_[margin + _TILE : margin + _TILE + height, margin + _TILE : margin + _TILE + width]
    rho = np.hypot(*_unbent(np.arange(width) - view.column, (view.row - np.arange(height))[:, None], view))
    return np.where(rho > view.radius + 7, 1.0, np.where(rho < view.radius * np.cos(beyond / 2) - 7, 0.0, image[cut]))
