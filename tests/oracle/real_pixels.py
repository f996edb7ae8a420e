"""Cells looked up in the pixels of a real picture of a distant sphere: truth for tables as they are made.

Imports nothing of the package. Directions are vectors, turned by cross products, and not the formulas of docs/model.md 3. The
nearest pixel is looked for among all of a patch; interpolation is by hat functions. A pixel's value is what it records over
the cosine of the light at its centre.
"""

from typing import NamedTuple

import numpy as np

from tests.oracle import sphere_cells


def shown_at(theta_h, theta_d, phi_d, radius=256.0):
    """(..., 2) px of the normals that have these angles, in the picture whose lamp stands towards +x."""
    theta_h, theta_d, phi_d = np.broadcast_arrays(theta_h, theta_d, phi_d)
    # about the half vector (z): light at azimuth phi_d, the normal tilted by theta_h away from azimuth 0
    light = np.stack([np.sin(theta_d) * np.cos(phi_d), np.sin(theta_d) * np.sin(phi_d), np.cos(theta_d)], -1)
    view = light * [-1, -1, 1]
    normal = np.stack([-np.sin(theta_h), 0 * theta_h, np.cos(theta_h)], -1)
    e_y = np.cross(view, light)
    e_y /= np.linalg.norm(e_y, axis=-1, keepdims=True)
    e_x = np.cross(e_y, view)
    return radius * np.stack([(normal * e_x).sum(-1), (normal * e_y).sum(-1)], -1)


class Behind(NamedTuple):
    """The pixels behind cells: place (cells, pixels, 2) px, share (cells, pixels), which adds up to 1."""

    position: np.ndarray
    share: np.ndarray


def about_axis(position, angle):
    """Places (..., 2) turned about the optical axis."""
    return position @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def behind(rule, phase, theta_h, theta_d, phi_d, radius=256.0, azimuth=0.0):
    """The pixels behind both places of each cell; theta_h and phi_d: (cells,). Those that show no light are left out.
    "mean" is that of all pixels whose directions fall into the cell, of the nearest where there are none. azimuth: of the
    lamp, which turns the sample's light and not the pixels; places are returned in the axes whose x points to the lamp."""
    if rule == "mean":
        return all_within(phase, theta_h, theta_d, phi_d, radius, azimuth)
    positions, shares = [], []
    offsets = np.array([(a, b) for a in range(-2, 4) for b in range(-2, 4)])
    for turn in (0, np.pi):
        at = about_axis(shown_at(theta_h, theta_d, phi_d + turn, radius), azimuth)[:, None]
        patch = np.floor(at - phase) + offsets + phase
        if rule == "nearest":
            nearest = np.argmin(((patch - at) ** 2).sum(-1), axis=1)
            positions.append(patch[np.arange(len(patch)), nearest][:, None])
            shares.append(np.ones((len(patch), 1)))
        else:
            hats = np.prod(np.maximum(1 - np.abs(patch - at), 0), axis=-1)
            four = np.argsort(-hats, axis=1)[:, :4]
            positions.append(np.take_along_axis(patch, four[..., None], 1))
            shares.append(np.take_along_axis(hats, four, 1))
    position, share = about_axis(np.concatenate(positions, 1), -azimuth), np.concatenate(shares, 1)
    inside = np.hypot(*np.moveaxis(position, -1, 0)) < radius
    share = np.where(inside & (light_cosine(position, theta_d, radius) > 0), share, 0)
    total = share.sum(1, keepdims=True)
    return Behind(position, share / np.where(total > 0, total, 1))


def cell_of(theta_h, psi):
    """Which cell of the grid holds directions: one number. Both azimuths of a pair of directions are one cell."""
    ring = np.floor(90 * np.sqrt(theta_h / (np.pi / 2)))
    return 180 * ring + np.floor(np.degrees(np.mod(np.pi - psi, np.pi)))


def all_within(phase, theta_h, theta_d, phi_d, radius, azimuth=0.0):
    nearest = behind("nearest", phase, theta_h, theta_d, phi_d, radius, azimuth)
    line = np.arange(-int(radius) - 1, int(radius) + 2)
    position = about_axis(np.stack(np.meshgrid(line, line), -1).reshape(-1, 2) + phase, -azimuth)
    position = position[np.hypot(*position.T) < radius]
    lit = position[light_cosine(position, theta_d, radius) > 0]
    lit = lit[np.argsort(cell_of(*angles_of(lit, theta_d, radius)), kind="stable")]
    numbers = cell_of(*angles_of(lit, theta_d, radius))
    first, last = (np.searchsorted(numbers, cell_of(theta_h, np.pi - phi_d), side) for side in ("left", "right"))
    most = max(2, (last - first).max())
    positions = np.repeat(nearest.position[:, :1], most, axis=1)
    shares = np.zeros((len(theta_h), most))
    for n, (a, b) in enumerate(zip(first, last, strict=True)):
        if a == b:
            positions[n, :2], shares[n, :2] = nearest.position[n], nearest.share[n]
        else:
            positions[n, : b - a], shares[n, : b - a] = lit[a:b], 1 / (b - a)
    return Behind(positions, shares)


def light_cosine(position, theta_d, radius=256.0):
    x, y = np.moveaxis(position, -1, 0) / radius
    return x * np.sin(2 * theta_d) + np.sqrt(np.maximum(1 - x**2 - y**2, 0)) * np.cos(2 * theta_d)


def angles_of(position, theta_d, radius=256.0):
    """(theta_h, psi) of pixels, by rotating the half vector onto z."""
    x, y = np.moveaxis(position, -1, 0) / radius
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    along = x * np.cos(theta_d) - z * np.sin(theta_d)
    return np.arctan2(np.hypot(along, y), x * np.sin(theta_d) + z * np.cos(theta_d)), np.arctan2(y, along)


class RealTable:
    """Cells of some slices of a table. cells: for each theta_d (theta_h, phi_d), two arrays of one length. phase: of all
    pictures, (2,), or of each. azimuth: of the lamp; where pixels lie is right then, but they are seen as if turned with it."""

    def __init__(self, rule, phase, theta_d, cells, setup=None, finest=0.0, azimuth=0.0):
        setup = setup or sphere_cells.Setup()
        radius, self.theta_d = setup.radius, np.asarray(theta_d)
        self.share, self.index = [], []
        columns = []
        phases = np.broadcast_to(phase, (self.theta_d.size, 2))
        for td, (theta_h, phi_d), shift in zip(self.theta_d, cells, phases, strict=True):
            found = behind(rule, shift, theta_h, td, phi_d, radius, azimuth)
            number = np.rint(about_axis(found.position, azimuth) - shift).astype(int)
            pixels, index = np.unique(number.reshape(-1, 2), axis=0, return_inverse=True)
            self.share.append(found.share)
            self.index.append(index.reshape(found.share.shape))
            columns.append(angles_of(about_axis(pixels + shift, -azimuth), td, radius))
        most = max(len(th) for th, _ in columns)
        self.count = [len(th) for th, _ in columns]
        th, psi = (np.stack([np.pad(c[n], (0, most - len(c[n])), mode="edge") for c in columns]) for n in (0, 1))
        self.rule = sphere_cells.Cells(th, self.theta_d, np.pi - psi, setup, turns=(0.0,), finest=finest)

    def pixels(self, lobe):
        """What every pixel's value is, (slices, pixels), 1/sr at F = 1."""
        return self.rule.directions(lobe)[..., 0]

    def values(self, pixels, rng=None, relative=0.01, floor=1e-4, gain=0.0):
        """For each slice the cells' values, of noisy pixels where rng is given."""
        out = []
        for j, (share, index) in enumerate(zip(self.share, self.index, strict=True)):
            own = pixels[j, : self.count[j]]
            if rng is not None:
                e = rng.standard_normal((2, own.size))
                own = own * (1 + relative * e[0]) + floor * np.nanmax(own, initial=0) * e[1]
                own = own * (1 + gain * rng.standard_normal())
            out.append(np.where(share.any(1), np.where(share > 0, share * own[index], 0).sum(1), np.nan))
        return out
