"""A field of dark, rotated squares as exact integrals over pixels; imports nothing of the package.

A square's response is the product of its four sides' own, which is exact but within a few px of its corners.
"""

import numpy as np

from tests.oracle.slanted_edge import edge


def field(shape, pitch, side, degrees, sigma, half_width=0.5, dark=0.2, light=0.0):
    """(picture, sides): expected values, 1 where it is bright, and (4 n, 3) middles x, y and normals (rad, towards the
    bright side) of all sides. degrees: rotation of each square and of their field. light: fall-off towards the corners."""
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
            inside = inside * edge(side / 2 - (x[part] - cx) * c - (y[part] - cy) * s, normal, sigma, half_width)
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
