"""What a pixel records of a brushed sphere under a distant lamp towards +x, where neither limb nor terminator is near: GGX with
two roughnesses (Heitz 2014), a Gaussian lens, a box pixel. Imports nothing of the package.

The product of two Gauss-Legendre rules on the sensor under the kernel, in many panels, with two orders that must agree.
"""

import numpy as np
from scipy.special import erfc


def record(x, y, lamp_angle, alphas, radius, sigma=0.5, half_width=0.5, panels=28):
    """Radiance under unit irradiance, 1/sr, at F = 1; (along, across) of `alphas`: along is in the plane of x and the axis."""
    values = [_record(x, y, lamp_angle, alphas, radius, sigma, half_width, panels, order) for order in (8, 11)]
    assert abs(values[0] / values[1] - 1) < 1e-6, (x, y, alphas, values)
    return values[1]


def _record(x, y, lamp_angle, alphas, radius, sigma, half_width, panels, order):
    reach = half_width + 9 * sigma
    unit, weight = np.polynomial.legendre.leggauss(order)
    cuts = np.linspace(-reach, reach, panels + 1)
    half = np.diff(cuts)[:, None] / 2
    offset, share = (cuts[:-1, None] + half * (1 + unit)).ravel(), (half * weight).ravel()
    step = np.sqrt(2) * sigma
    kernel = (erfc((np.abs(offset) - half_width) / step) - erfc((np.abs(offset) + half_width) / step)) / (
        4 * half_width
    )
    n_x, n_y = np.meshgrid((x + offset) / radius, (y + offset) / radius, indexing="ij")
    n_z = np.sqrt(1 - n_x**2 - n_y**2)
    normal = np.stack([n_x, n_y, n_z])
    first = np.stack([n_z, 0 * n_x, -n_x]) / np.hypot(n_x, n_z)
    frame = first, np.cross(normal, first, axis=0), normal
    light, view = np.array([np.sin(lamp_angle), 0, np.cos(lamp_angle)]), np.array([0.0, 0, 1])
    half_vector = (light + view) / np.linalg.norm(light + view)
    at = [[np.tensordot(v, axis, 1) for axis in frame] for v in (half_vector, light, view)]
    (h, i, o), (a, b) = at, alphas
    stretched2 = (h[0] / h[2] / a) ** 2 + (h[1] / h[2] / b) ** 2
    d = 1 / (np.pi * a * b * h[2] ** 4 * (1 + stretched2) ** 2)
    hidden = [np.sqrt(1 + ((a * w[0]) ** 2 + (b * w[1]) ** 2) / w[2] ** 2) / 2 - 0.5 for w in (i, o)]
    light_sent = d / (1 + sum(hidden)) / (4 * o[2])
    return float((kernel * share) @ light_sent @ (kernel * share))
