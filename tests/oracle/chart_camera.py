"""A camera that photographs a chart: pinhole in any pose, distortion, Gaussian blur, square pixels, vignetting, mosaic, noise.

Takes a chart's description as the JSON has it (mm, x right, y down) and imports nothing of the package. Sensor: px, pixel
centres on whole numbers, row 0 on top. Every kernel is Gaussian times square, exactly; where things come from:

- Dots: quadrature over the disc, each node through the kernel's closed form.
- Edges (squares, bars, patches, fiducials): already blurred by a part of the Gaussian, in closed form along the local
  normal, sampled `FINE` times per px, the rest of the kernel summed over the samples. What folds over is below
  1e-6 from sigma 0.4 px on (tested).
- Sines (stars, sine gratings): sampled as finely, the whole kernel summed.

Distances are those to the tangent, so that edges bowed by distortion are exact to about (curvature x blur^2) = 1e-4 px; corners
and the ends of gratings only look right. Sines are true sines, not the printer's steps.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.special import ndtr

FINE = 4
_MARGIN = 9  # px around an element
_CUT = 8.5  # standard deviations
MOSAICS = {"RGGB": ((0, 1), (1, 2)), "BGGR": ((2, 1), (1, 0)), "GRBG": ((1, 0), (2, 1)), "GBRG": ((1, 2), (0, 1))}
COLOURS = (0.6, 1.0, 0.7)  # of white paper, in R, G, B


@dataclass
class ChartCamera:
    """width, height: px. page: mm. filled: share of the picture's width that the page would fill, seen from the front.

    tilt: rad about the picture's vertical and horizontal axes; roll: about the optical one. distance: of the lens, in
    widths of the page. distortion: how far the corner is moved, relative to its distance from the centre. vignetting: light
    that the corner loses. sigma: px. fill: linear, of the pixel's sensitive square.
    """

    width: int
    height: int
    page: tuple
    filled: float = 0.92
    tilt: tuple = (0.0, 0.0)
    roll: float = 0.0
    shift: tuple = (0.0, 0.0)
    distance: float = 2.5
    distortion: float = 0.0
    vignetting: float = 0.0
    sigma: float = 0.5
    fill: float = 1.0
    _homography: np.ndarray = field(init=False)
    _focal: float = field(init=False)

    def __post_init__(self):
        (a, b), c = self.tilt, self.roll
        turn = (
            np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
            @ np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
            @ np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
        )
        far = self.distance * self.page[0]
        self._focal = far * self.filled * self.width / self.page[0]
        plane = np.column_stack([turn[:, 0], turn[:, 1], [0, 0, far]])
        to_middle = np.array([[1, 0, -self.page[0] / 2], [0, 1, -self.page[1] / 2], [0, 0, 1]])
        self._homography = np.diag([self._focal, self._focal, 1]) @ plane @ to_middle

    # ------------------------------------------------------------------ geometry

    def page_of(self, x, y):
        """mm on the page that px on the sensor see."""
        u, v = x - (self.width - 1) / 2, y - (self.height - 1) / 2
        scale = 1 + self._bend(u, v)
        a, b, c = np.linalg.inv(self._homography)
        u, v = u * scale - self.shift[0], v * scale - self.shift[1]
        w = c[0] * u + c[1] * v + c[2]
        return (a[0] * u + a[1] * v + a[2]) / w, (b[0] * u + b[1] * v + b[2]) / w

    def sensor_of(self, x, y):
        """px on the sensor where mm on the page appear."""
        h = self._homography
        w = h[2, 0] * x + h[2, 1] * y + h[2, 2]
        u, v = ((h[i, 0] * x + h[i, 1] * y + h[i, 2]) / w + self.shift[i] for i in (0, 1))
        bent_u, bent_v = u, v
        for _ in range(40):
            scale = 1 + self._bend(bent_u, bent_v)
            bent_u, bent_v = u / scale, v / scale
        return bent_u + (self.width - 1) / 2, bent_v + (self.height - 1) / 2

    def _bend(self, u, v):
        return self.distortion * (u**2 + v**2) / ((self.width**2 + self.height**2) / 4)

    def mtf(self, f, direction):
        """Of lens and pixel."""
        box = np.sinc(self.fill * f * np.cos(direction)) * np.sinc(self.fill * f * np.sin(direction))
        return np.exp(-2 * (np.pi * self.sigma * f) ** 2) * box

    # ------------------------------------------------------------------ pictures

    def expected(self, chart, fine=FINE):
        """(height, width) levels, of paper 1, before vignetting, mosaic and noise."""
        picture = np.ones((self.height, self.width))
        for mark in chart["fiducials"]:
            self._round(picture, mark, chart["ink_level"], fine)
        for element in chart["elements"]:
            kind = element["kind"]
            if kind == "dots":
                self._dots(picture, element)
            elif kind == "star":
                self._star(picture, element, fine)
            elif kind == "grating":
                self._grating(picture, element, fine)
            else:
                self._polygon(picture, element, fine)
        return picture

    def light(self):
        """(height, width) vignetting, 1 in the middle."""
        y, x = np.mgrid[: self.height, : self.width]
        u, v = x - (self.width - 1) / 2, y - (self.height - 1) / 2
        return 1 - self.vignetting * (u**2 + v**2) / ((self.width**2 + self.height**2) / 4)

    def photograph(self, expected, snr, seed, cfa=None):
        """Counts of photo-electrons, snr^2 from bright paper (in green)."""
        picture = expected * self.light()
        if cfa is not None:
            tile = np.array(COLOURS)[np.array(MOSAICS[cfa])]
            picture = picture * np.tile(tile, (self.height // 2 + 1, self.width // 2 + 1))[: self.height, : self.width]
        return np.random.default_rng(seed).poisson(picture * snr**2).astype(float)

    # ------------------------------------------------------------------ elements

    def _window(self, points, fine):
        """Rows and columns of the picture around points on the page, and the fine grid's page coordinates there."""
        x, y = self.sensor_of(*np.asarray(points, dtype=float).T)
        low = np.floor([x.min(), y.min()]).astype(int) - _MARGIN
        high = np.ceil([x.max(), y.max()]).astype(int) + _MARGIN + 1
        low, high = np.maximum(low, 0), np.minimum(high, [self.width, self.height])
        if (high <= low).any():
            return None
        reach = self._reach()
        px, py = (
            (np.arange(-reach * fine, (b - a - 1 + reach) * fine + 1) / fine + a)
            for a, b in zip(low, high, strict=True)
        )
        return slice(low[1], high[1]), slice(low[0], high[0]), px, py

    def _reach(self):
        return int(np.ceil(self.fill / 2 + _CUT * self.sigma))

    def _sum(self, samples, sigma, fine):
        """Pixels from fine samples, by the kernel of a Gaussian and the square."""
        reach, half = self._reach(), self.fill / 2
        u = np.arange(-reach * fine, reach * fine + 1) / fine
        kernel = (ndtr((u + half) / sigma) - ndtr((u - half) / sigma)) / (2 * half) / fine
        for _ in range(2):
            count = (len(samples) - 1) // fine - 2 * reach + 1
            samples = sum(
                w * samples[i : i + (count - 1) * fine + 1 : fine] for i, w in enumerate(kernel) if w > 1e-16
            ).T
        return samples

    def _seen(self, px, py):
        """Page coordinates of a grid on the sensor, (2, rows, columns), and their derivatives by its x and y."""
        x, y = np.meshgrid(px, py)
        here, e = np.array(self.page_of(x, y)), 1e-4
        return here, *((np.array(self.page_of(x + a, y + b)) - here) / e for a, b in ((e, 0), (0, e)))

    def _add(self, picture, points, layers, fine):
        """layers(seen, s) -> levels that are blurred by s already, and levels that are not blurred at all."""
        window = self._window(points, fine)
        if window is None:
            return
        rows, columns, px, py = window
        part = self.sigma / np.sqrt(2)
        blurred, sharp = layers(self._seen(px, py), part)
        picture[rows, columns] += self._sum(blurred, part, fine)
        if sharp is not None:
            picture[rows, columns] += self._sum(sharp, self.sigma, fine)

    def _inside(self, corners, seen, s):
        """Share of a convex polygon in a Gaussian of standard deviation s: the product over its sides."""
        corners = np.asarray(corners, dtype=float)
        middle, share = corners.mean(0), 1.0
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            normal = np.array([a[1] - b[1], b[0] - a[0]])
            normal *= np.sign(normal @ (middle - a)) / np.hypot(*normal)
            share = share * ndtr(distance(seen, normal, normal @ a) / s)
        return share

    def _polygon(self, picture, element, fine):
        corners = element["corners_mm"]
        self._add(
            picture, corners, lambda seen, s: ((element["level"] - 1) * self._inside(corners, seen, s), None), fine
        )

    def _round(self, picture, mark, ink, fine):
        """Discs and rings, larger than the blur."""
        (cx, cy), r = mark["centre_mm"], mark["radius_mm"]

        def layers(seen, s):
            value, slope = radius_of(seen, cx, cy)
            edges = [r * n for n in range(2 * mark["rings"] + 2) if n]
            signs = [(-1) ** n for n in range(len(edges))]
            return (ink - 1) * sum(
                sign * ndtr((e - value) / slope / s) for e, sign in zip(edges, signs, strict=True)
            ), None

        outer = (2 * mark["rings"] + 1) * r
        corners = np.array([cx, cy]) + outer * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        self._add(picture, corners, layers, fine)

    def _dots(self, picture, element):
        nodes, weights = np.polynomial.legendre.leggauss(8)
        turns = 2 * np.pi * np.arange(24) / 24
        radius = element["radius_mm"] * np.sqrt((nodes + 1) / 2)
        area = np.pi * element["radius_mm"] ** 2 * np.repeat(weights / 2, 24) / 24
        u, v = (radius[:, None] * np.cos(turns)).ravel(), (radius[:, None] * np.sin(turns)).ravel()
        half, reach = self.fill / 2, self._reach() + 4
        for cx, cy in element["centres_mm"]:
            x, y = self.sensor_of(cx + u, cy + v)
            # mm^2 of the page that one px^2 of the sensor sees, at every node
            e = 1e-3
            (a, b), (c, d) = self.page_of(x + e, y), self.page_of(x - e, y)
            (p, q), (r, t) = self.page_of(x, y + e), self.page_of(x, y - e)
            weight = area / abs((a - c) * (q - t) - (b - d) * (p - r)) * 4 * e**2
            cell = [slice(max(round(float(m.mean())) - reach, 0), round(float(m.mean())) + reach + 1) for m in (y, x)]
            rows, columns = np.arange(self.height)[cell[0]], np.arange(self.width)[cell[1]]
            if not (rows.size and columns.size):
                continue
            sigma = self.sigma_of_dot(x.mean(), y.mean())
            along, across = (
                (ndtr((g[:, None] - m + half) / sigma) - ndtr((g[:, None] - m - half) / sigma)) / (2 * half)
                for g, m in ((rows, y), (columns, x))
            )
            picture[cell[0], cell[1]] += (element["level"] - 1) * (along * weight) @ across.T

    def sigma_of_dot(self, x, y):
        """Blur of a dot at (x, y) px: to be replaced where the lens changes over the field, which only dots see."""
        return self.sigma

    def _star(self, picture, star, fine):
        (cx, cy), inner, outer = star["centre_mm"], star["inner_mm"], star["outer_mm"]
        mean, amplitude = (star["bright"] + star["dark"]) / 2, (star["bright"] - star["dark"]) / 2

        def layers(seen, s):
            value, slope = radius_of(seen, cx, cy)
            inside = ndtr((outer - value) / slope / s) - ndtr((inner - value) / slope / s)
            soft = ndtr((outer - value) / slope / 0.6) * ndtr((value - inner) / slope / 0.6)
            u, v = seen[0]
            wave = np.cos(star["cycles"] * np.arctan2(v - cy, u - cx) + star["phase_rad"])
            return (mean - 1) * inside, amplitude * soft * wave

        self._add(picture, np.array([cx, cy]) + outer * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]), layers, fine)

    def _grating(self, picture, grating, fine):
        centre, size, angle = np.array(grating["centre_mm"]), grating["size_mm"], grating["angle_rad"]
        across, along = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        corners = [
            centre + a * across * size[0] / 2 + b * along * size[1] / 2 for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
        ]
        dark, bright, period, duty = (grating[name] for name in ("dark", "bright", "period_mm", "duty"))

        def layers(seen, s):
            inside = self._inside(corners, seen, s)
            u = distance(seen, across, across @ centre)
            slope = np.hypot(*(np.tensordot(across, d, 1) for d in seen[1:])) / period
            value = u * slope + grating["phase_rad"] / (2 * np.pi)
            if grating["profile"] == "sine":
                mean, amplitude = (bright + dark) / 2, (bright - dark) / 2
                soft = self._inside(corners, seen, 0.6)
                return (mean - 1) * inside, amplitude * soft * np.cos(2 * np.pi * value)
            # bars whose blur reaches a point: those within so many periods
            t, wave = value - np.round(value), 0.0
            for n in range(-1 - int(np.ceil(7 * s * slope.max())), 2 + int(np.ceil(7 * s * slope.max()))):
                wave = wave + ndtr((t - n + duty / 2) / slope / s) - ndtr((t - n - duty / 2) / slope / s)
            return (dark - 1 + (bright - dark) * wave) * inside, None

        self._add(picture, corners, layers, fine)


def distance(seen, normal, offset):
    """px of the sensor to a line on the page, positive along its unit normal."""
    here, by_x, by_y = (np.tensordot(normal, d, 1) for d in seen)
    return (here - offset) / np.hypot(by_x, by_y)


def radius_of(seen, cx, cy):
    """mm on the page from a point, and how fast that grows per px of the sensor."""
    u, v = seen[0][0] - cx, seen[0][1] - cy
    radius = np.maximum(np.hypot(u, v), 1e-9)
    return radius, np.maximum(np.hypot(*((u * d[0] + v * d[1]) / radius for d in seen[1:])), 1e-9)
