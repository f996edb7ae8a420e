"""A field of dark, rotated squares as exact integrals over pixels; imports nothing of the package.

A square's response is the product of its four sides' own, which is exact but within a few px of its corners.
"""

import numpy as np
from scipy.interpolate import CubicSpline

from tests.oracle.slanted_edge import edge


def diffracted(cutoff, sigma, degrees, half_width):
    """Edge response of an ideal lens with a Gaussian core and a square pixel, for normals at so many degrees to the grid's
    rows or columns: a spline through quadratures at every 32nd of a px, straight beyond 48 px. Errors below 1e-6."""
    angle = np.radians(degrees)
    nodes, weights = np.polynomial.legendre.leggauss(16)
    borders = np.linspace(0, 1, 121)
    t = (borders[:-1, None] + np.diff(borders)[:, None] * (nodes + 1) / 2).ravel()
    dt = (np.diff(borders)[:, None] * weights / 2).ravel()
    f, df = cutoff * t * (2 - t), cutoff * 2 * (1 - t) * dt
    nu = f / cutoff
    lens = 2 / np.pi * (np.arccos(nu) - nu * np.sqrt(1 - nu**2)) * np.exp(-2 * (np.pi * sigma * f) ** 2)
    box = np.sinc(2 * half_width * f * np.cos(angle)) * np.sinc(2 * half_width * f * np.sin(angle))
    distance = np.arange(-48 * 32, 48 * 32 + 1) / 32
    spline = CubicSpline(distance, 0.5 + np.sin(2 * np.pi * np.outer(distance, f)) @ (lens * box * df / (np.pi * f)))
    return lambda d, normal: spline(np.clip(d, -48, 48))


def field(shape, pitch, side, degrees, sigma, half_width=0.5, dark=0.2, light=0.0, response=None):
    """(picture, sides): expected values, 1 where it is bright, and (4 n, 3) middles x, y and normals (rad, towards the
    bright side) of all sides. degrees: rotation of each square and of their field. light: fall-off towards the corners.
    response: of an edge, by distance and normal; None: of a Gaussian lens."""
    of_edge = response or (lambda d, normal: edge(d, normal, sigma, half_width))
    height, width = shape
    y, x = np.mgrid[:height, :width].astype(float)
    angle = np.radians(degrees)
    axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    count = int(np.hypot(height, width) / pitch) + 1
    steps = (np.mgrid[-count : count + 1, -count : count + 1].reshape(2, -1).T + 0.25) * pitch
    centres = steps @ axes + np.array([width / 2 + 0.3, height / 2 - 0.2])
    reach = side * 0.75
    centres = centres[np.all((centres > reach) & (centres < np.array([width, height]) - reach), axis=1)]
    covered, sides = np.zeros(shape), []
    for cx, cy in centres:
        x0, x1, y0, y1 = (int(v) for v in (cx - reach - 8, cx + reach + 8, cy - reach - 8, cy + reach + 8))
        part = np.s_[max(y0, 0) : y1, max(x0, 0) : x1]
        inside = np.ones_like(x[part])
        for turn in range(4):
            normal = angle + turn * np.pi / 2
            c, s = np.cos(normal), np.sin(normal)
            inside = inside * of_edge(side / 2 - (x[part] - cx) * c - (y[part] - cy) * s, normal)
            sides.append((cx + side / 2 * c, cy + side / 2 * s, np.angle(np.exp(1j * normal))))
        covered[part] += inside
    fall = light * (((x - width / 2) ** 2 + (y - height / 2) ** 2) / (width**2 + height**2) * 4)
    return (1 - (1 - dark) * covered) * (1 - fall), np.array(sides)


def mosaic(planes, cfa):
    """The sites of each colour of (R, G, B) pictures: colours of the first 2 x 2 px, row by row."""
    height, width = planes[0].shape
    colours = np.array(["RGB".index(c) for c in cfa]).reshape(2, 2)
    at = colours[np.ix_(np.arange(height) % 2, np.arange(width) % 2)]
    return np.choose(at, planes)
