"""Pictures of strips of material bent round a cylinder (Ngan et al. 2005): truth for what is read from photographs.

GGX with a roughness along the material's x axis and one across it (Heitz 2014), height-correlated Smith masking, Fresnel's
reflectance of n and k, a Lambertian part; a Gaussian lens and a box pixel. The cylinder's axis is the picture's y axis.
Vectors: x right, y up, z to the camera; row 0 on top. Lengths are in radii of the cylinder, the origin is on its axis.

Imports nothing of the package. Across the cylinder: Gauss-Legendre panels in the angle of the normal, each node through the
kernel's closed form. Along it the light changes smoothly: some rows of a strip, and the polynomial through them.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import erf, ndtr

from tests.oracle.capture import Drawn, Sensor, _channels, _expose, _of_channel, _row
from tests.oracle.sphere_picture import direction, fresnel


class Bent(NamedTuple):
    """alphas along the material's x axis and across it; n, k and diffuse albedo: one number for each channel, or one."""

    alphas: tuple = (0.1, 0.1)
    n: tuple = (1.5,)
    k: tuple = (0.0,)
    diffuse: tuple = (0.0,)


class Stand(NamedTuple):
    """radius: half the width of the outline, px; distances of camera and lamp from the axis, radii; lens and half pixel, px;
    column of the axis; row that camera and lamp are seen at from the axis; shape of the picture; strips: first and last row,
    the angle of the material's x axis from the direction round the cylinder (to the right) towards up, rad; drawn: number of
    rows of a strip that are computed."""

    radius: float = 200.0
    camera: float = np.inf
    lamp: float = np.inf
    sigma: float = 0.5
    half_width: float = 0.5
    column: float = 230.3
    row: float = 60.0
    shape: tuple = (120, 460)
    strips: tuple = ((0, 119, 0.0),)
    drawn: int = 6


def picture(surface, stand, towards, shift=0.0, fine=1):
    """Radiance (height, width, channels) at unit irradiance at the origin, 1/sr. shift: of the axis, px."""
    u, weight = _nodes(stand, fine)
    q = 1 / stand.camera
    stretch = stand.radius * np.sqrt(1 - q**2)
    depth = 1 - q * np.cos(u)
    position = stand.column + shift + stretch * np.sin(u) / depth
    share = weight * stretch * (np.cos(u) - q) / depth**2
    columns = np.arange(stand.shape[1])[:, None]
    unit = np.sqrt(2) * stand.sigma
    kernel = erf((position - columns + stand.half_width) / unit) - erf((position - columns - stand.half_width) / unit)
    kernel *= share / (4 * stand.half_width)
    rows = np.arange(stand.shape[0])
    image = np.zeros((*stand.shape, max(len(surface.n), len(surface.diffuse))))
    for first, last, turn in stand.strips:
        at = (first + last) / 2 + max(last - first, 1) / 2 * np.cos(
            np.pi * (np.arange(stand.drawn) + 0.5) / stand.drawn
        )
        profiles = [
            _profile(surface, stand, towards, turn, u, (stand.row - row) / stretch * depth, kernel) for row in at
        ]
        inside = _covered(rows, first - 0.5, last + 0.5, stand)
        for i, profile in enumerate(profiles):  # Lagrange's polynomial through the rows
            others = np.delete(at, i)
            share = np.prod((rows[:, None] - others) / (at[i] - others), axis=1)
            image += np.where(inside > 1e-12, inside * share, 0.0)[:, None, None] * profile
    return image


def _nodes(stand, fine):
    end = np.arccos(1 / stand.camera)
    cuts = np.linspace(-end, end, 600 * fine + 1)
    unit, weight = np.polynomial.legendre.leggauss(8)
    half = np.diff(cuts)[:, None] / 2
    return (cuts[:-1, None] + half * (1 + unit)).ravel(), (half * weight).ravel()


def _covered(rows, top, bottom, stand):
    """Share of each row's kernel that lies between two heights of the picture: the box is taken as its own Gaussian."""
    spread = np.hypot(stand.sigma, stand.half_width / np.sqrt(3))
    return ndtr((bottom - rows) / spread) - ndtr((top - rows) / spread)


def _profile(surface, stand, towards, turn, u, height, kernel):
    """Radiance that every column records at one row, (columns, channels)."""
    normal = np.stack([np.sin(u), 0 * u, np.cos(u)])
    point = np.stack([np.sin(u), height, np.cos(u)])
    light = np.asarray(towards)[:, None] - point / stand.lamp
    away2 = (light**2).sum(0)
    light, view = light / np.sqrt(away2), np.array([0, 0, 1.0])[:, None] - point / stand.camera
    view /= np.sqrt((view**2).sum(0))
    around, up = np.stack([np.cos(u), 0 * u, -np.sin(u)]), np.array([0, 1.0, 0])[:, None]
    first = np.cos(turn) * around + np.sin(turn) * up
    second = np.cos(turn) * up - np.sin(turn) * around
    half = light + view
    half /= np.sqrt((half**2).sum(0))
    (hx, ix, ox), (hy, iy, oy), (hz, iz, oz) = (
        [(axis * one).sum(0) for one in (half, light, view)] for axis in (first, second, normal)
    )
    lit = (iz > 0) & (oz > 0)
    ax, ay = surface.alphas
    iz, oz = np.where(lit, iz, 1.0), np.where(lit, oz, 1.0)
    d = 1 / (np.pi * ax * ay * ((hx / ax) ** 2 + (hy / ay) ** 2 + hz**2) ** 2)
    hidden = sum(
        (np.sqrt(1 + ((ax * x) ** 2 + (ay * y) ** 2) / z**2) - 1) / 2 for x, y, z in ((ix, iy, iz), (ox, oy, oz))
    )
    lobe = np.where(lit, d / (1 + hidden) / (4 * oz) / away2, 0.0)
    body = np.where(lit, iz / np.pi / away2, 0.0)
    cos_d = (half * light).sum(0)
    channels = max(len(surface.n), len(surface.diffuse))
    out = []
    for c in range(channels):
        n, k, rho = (v[min(c, len(v) - 1)] for v in (surface.n, surface.k, surface.diffuse))
        out.append(kernel @ (lobe * fresnel(cos_d, n, k) + rho * body))
    return np.stack(out, axis=-1)


def backlit(stand, lean=0.0):
    """Share of a bright field's light in each pixel (height, width) before which the cylinder stands. lean: columns by row."""
    spread = np.hypot(stand.sigma, stand.half_width / np.sqrt(3))
    rows, columns = np.indices(stand.shape)
    x = columns - stand.column - lean * (rows - stand.row)
    return ndtr((x - stand.radius) / spread) + ndtr((-x - stand.radius) / spread)


def draw(
    surface,
    stand,
    angles,
    azimuths,
    *,
    exposures=4,
    step=4.0,
    sensor=None,
    lamp_std=0.0,
    shift_std=0.2,
    gain_std=0.005,
    lens_std=0.03,
    outline=True,
    seed=0,
):
    """Draw a capture of a cylinder: pictures with Poisson and read noise, darks, a backlit frame. angles, azimuths: of the
    lamps, rad. lamp_std: of the table, rad."""
    sensor = sensor or Sensor(cfa=None)
    rng = np.random.default_rng(seed)
    drawn = Drawn()
    channel = _channels(stand.shape, sensor)
    sensitivity = np.asarray(sensor.sensitivity if sensor.cfa else (1.0,))
    gains = np.exp(gain_std * rng.standard_normal(len(angles)))
    shifts = shift_std * rng.standard_normal(len(angles))
    seen = []
    for angle, azimuth, shift in zip(angles, azimuths, shifts, strict=True):
        colours = picture(surface, stand, direction(angle, azimuth), shift)
        seen.append(_of_channel(colours, channel) * sensitivity[channel])
    scale = 0.7 * sensor.full_well / max((g * s).max() for g, s in zip(gains, seen, strict=True))
    relative = step ** np.arange(exposures)
    for i, (clean, gain) in enumerate(zip(seen, gains, strict=True)):
        said = np.degrees(angles[i] + lamp_std * rng.standard_normal())
        turned = np.degrees(azimuths[i] + lamp_std * rng.standard_normal() / max(np.sin(angles[i]), 0.05))
        for k, ratio in enumerate(relative):
            file = f"frames/L{i:02d}_E{k}.tif"
            drawn.frames[file] = _expose(scale * gain * ratio * clean, sensor, rng)
            drawn.rows.append(_row(file, f"L{i:02d}", abs(said), turned, f"E{k}", ratio / 1000))
    for k, ratio in enumerate(relative):
        for i in range(2):
            drawn.frames[f"dark/D{i}_E{k}.tif"] = _expose(np.zeros(stand.shape), sensor, rng)
            drawn.rows.append(_row(f"dark/D{i}_E{k}.tif", "", None, None, f"E{k}", ratio / 1000))
    sample = {
        "kind": "cylinder",
        "radius_mm": 20.0,
        "centre_row_px": [stand.row, 1.0],
        "strip_rows_px": [[int(first), int(last)] for first, last, _ in stand.strips],
        "strip_turn_deg": [float(np.degrees(turn)) for *_, turn in stand.strips],
    }
    if outline:
        drawn.frames["outline/O0.tif"] = _expose(
            0.6 * sensor.full_well * backlit(stand) * sensitivity[channel], sensor, rng
        )
        drawn.rows.append(_row("outline/O0.tif", "", None, None, "E0", 1e-3))
    else:
        sample |= {"outline_radius_px": [stand.radius, 0.05], "axis_column_px": [stand.column, 0.05]}
    drawn.settings = {
        "format": "matcam capture",
        "version": 1,
        "camera": {"profile": "camera.json"} | ({"cfa": sensor.cfa} if sensor.cfa else {}),
        "sample": sample,
        "lamp": {"direction_std_deg": float(np.degrees(max(lamp_std, 1e-5))), "gain_std": gain_std},
        "outline": {"field_beyond_deg": 0.0},
        "distances": {
            f"{name}_mm": [20.0 * distance, 0.1]
            for name, distance in (("camera", stand.camera), ("lamp", stand.lamp))
            if np.isfinite(distance)
        },
    }
    if not drawn.settings["distances"]:
        drawn.settings["distances"] = {"camera_mm": [1e8, 1.0], "lamp_mm": [1e8, 1.0]}
    sigma = stand.sigma * np.exp(lens_std * rng.standard_normal())
    drawn.profile = {
        "format": "matcam camera profile",
        "version": 2,
        "optics": {"model": "gaussian", "sigma_px": sigma},
        "pixel": {"model": "box", "half_width_px": stand.half_width},
        "uncertainty": {"parameters": ["optics.sigma_px"], "covariance": [[(lens_std * sigma) ** 2]]},
        "provenance": {"source": "synthetic", "created": "2026-01-01", "software": "an oracle", "notes": ""},
    }
    drawn.truth = {
        "surface": surface._asdict(),
        "angles": list(angles),
        "azimuths": list(azimuths),
        "gains": list(gains),
    }
    return drawn
