"""Random photographs of a chart in the real world: aslant, bent, badly printed, badly lit, with a hand in the way.

Takes a chart's description as the JSON has it and imports nothing of the package. `ChartCamera` draws; added here are:

- Curl: the page is a cylinder, and every ray meets it where it is.
- Print: a level is printed as its power. What was a sine is none any more, and is drawn as what it became.
- Table: the page ends, and what it lies on is darker or as bright.
- Shadow and hand: soft border of a shadow, blurred border of a hand; neither is sharper than the lens.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr

from tests.oracle.chart_camera import ChartCamera, radius_of

_ROUNDS = 12  # fixed-point steps to where a ray meets a bent page


@dataclass
class BentPageCamera(ChartCamera):
    """sag: how far the page's middle stands off the plane of its ends, in its widths. bent: rad, direction along which it is.
    gamma: a level is printed as its power. table: level beside the page."""

    sag: float = 0.0
    bent: float = 0.0
    gamma: float = 1.0
    table: float = 1.0
    _whole: np.ndarray = field(init=False)

    def __post_init__(self):
        super().__post_init__()
        # the third column of the pinhole's matrix, that of heights above the page: normal to the two of the page
        lens = np.diag([self._focal, self._focal, 1])
        plane = np.linalg.inv(lens) @ self._homography
        up = np.cross(plane[:, 0], plane[:, 1])
        self._whole = lens @ np.column_stack([plane[:, :2], up, plane[:, 2]])
        self._eye = np.linalg.solve(self._whole[:, :3], -self._whole[:, 3])

    def _height(self, x, y):
        u = (x - self.page[0] / 2) * np.cos(self.bent) + (y - self.page[1] / 2) * np.sin(self.bent)
        return self.sag * self.page[0] * (1 - (2 * u / self.page[0]) ** 2)

    def page_of(self, x, y):
        at_x, at_y = flat_x, flat_y = super().page_of(x, y)
        for _ in range(_ROUNDS if self.sag else 0):
            share = self._height(at_x, at_y) / self._eye[2]
            at_x, at_y = flat_x + (self._eye[0] - flat_x) * share, flat_y + (self._eye[1] - flat_y) * share
        return at_x, at_y

    def sensor_of(self, x, y):
        # where a ray through a raised point meets the plane, and from there as ever
        share = self._height(x, y) / self._eye[2]
        return super().sensor_of((x - self._eye[0] * share) / (1 - share), (y - self._eye[1] * share) / (1 - share))

    def expected(self, chart, fine=3):
        printed = {**chart, "ink_level": chart["ink_level"] ** self.gamma}
        printed["elements"] = [
            {k: v**self.gamma if k in ("level", "dark", "bright") and e["kind"] != "star" else v for k, v in e.items()}
            for e in chart["elements"]
        ]
        picture = super().expected(printed, fine)
        if self.table != 1:
            width, height = self.page
            edge = {"corners_mm": [[0, 0], [width, 0], [width, height], [0, height]], "level": 1.0}
            inside = np.zeros_like(picture)
            self._outline(inside, edge["corners_mm"])
            picture += (self.table - 1) * (1 - inside)
        return picture

    def _outline(self, picture, corners):
        """Share of the page in every pixel; its border is blurred as much as the rest, but not in detail."""
        x, y = np.meshgrid(np.arange(self.width, dtype=float), np.arange(self.height, dtype=float))
        e, (u, v) = 1e-3, self.page_of(x, y)
        inside = 1.0
        for value, slope in (
            (u, self.page_of(x + e, y)[0]), (v, self.page_of(x, y + e)[1]),
        ):  # fmt: skip
            size = self.page[0] if value is u else self.page[1]
            scale = max(float(np.median(np.abs(slope - value))) / e, 1e-6) * max(self.sigma, 0.5)
            inside = inside * ndtr(value / scale) * ndtr((size - value) / scale)
        picture += inside

    def _star(self, picture, star, fine):
        (cx, cy), inner, outer = star["centre_mm"], star["inner_mm"], star["outer_mm"]
        mean, amplitude = (star["bright"] + star["dark"]) / 2, (star["bright"] - star["dark"]) / 2
        turn = 2 * np.pi * np.arange(256) / 256
        usual = ((mean + amplitude * np.cos(turn)) ** self.gamma).mean()

        def layers(seen, s):
            value, slope = radius_of(seen, cx, cy)
            inside = ndtr((outer - value) / slope / s) - ndtr((inner - value) / slope / s)
            soft = ndtr((outer - value) / slope / 0.6) * ndtr((value - inner) / slope / 0.6)
            u, v = seen[0]
            wave = np.cos(star["cycles"] * np.arctan2(v - cy, u - cx) + star["phase_rad"])
            return (usual - 1) * inside, soft * ((mean + amplitude * wave) ** self.gamma - usual)

        self._add(picture, np.array([cx, cy]) + outer * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]), layers, fine)


@dataclass
class Frame:
    """A photograph of a chart: counts; the camera that took it; what was drawn, in words."""

    counts: np.ndarray
    camera: BentPageCamera
    drawn: dict


def pose_of(page, pixels, draw):
    """Camera and its circumstances at random.

    pixels: of the page's width, seen from the front. draw: a generator.
    """
    tilt, towards = np.radians(draw.uniform(0, 45)) * draw.uniform(0, 1) ** 0.5, draw.uniform(0, 2 * np.pi)
    pose = {
        "tilt": (tilt * np.cos(towards), tilt * np.sin(towards)),
        "roll": draw.uniform(-np.pi, np.pi),
        "distance": draw.uniform(1.6, 4.0),
        "distortion": draw.uniform(-0.02, 0.15) if draw.random() < 0.7 else 0.0,
        "vignetting": draw.uniform(0, 0.4),
        "sigma": draw.uniform(0.5, 1.1),
        "sag": draw.uniform(0, 0.01) if draw.random() < 0.5 else 0.0,
        "bent": draw.uniform(0, np.pi),
        "gamma": draw.uniform(1, 2.2) if draw.random() < 0.5 else 1.0,
        "table": draw.uniform(0.1, 1.0),
    }
    # the picture is as large as the page in it, and a little more
    size = np.array([pixels, pixels], dtype=int)
    for _ in range(6):
        camera = BentPageCamera(int(size[0]), int(size[1]), page, filled=pixels / size[0], **pose)
        rim = np.linspace(0, 1, 9)
        border = [(u, v) for a in rim for u, v in ((a, 0), (a, 1), (0, a), (1, a))]
        with np.errstate(all="ignore"):
            at = np.stack(camera.sensor_of(*(np.array(border) * page).T), -1)
        reach = 2 * np.abs(at - (size - 1) / 2).max(0)
        size = np.maximum(np.round(reach * 1.04), 64).astype(int)
    return BentPageCamera(int(size[0]), int(size[1]), page, filled=pixels / size[0], **pose)


def random_frame(chart, page, pixels, seed, *, hand=None, shadow=None):
    """A frame of a chart; everything about it by the seed. hand, shadow: force one, or none."""
    draw = np.random.default_rng(seed)
    camera = pose_of(page, pixels, draw)
    light = camera.light()
    y, x = np.mgrid[: camera.height, : camera.width]
    x, y = (x - camera.width / 2) / camera.width, (y - camera.height / 2) / camera.width
    drawn = {"shadow": 0.0, "hand": 0.0}
    turn, position, soft = draw.uniform(0, 2 * np.pi), draw.uniform(-0.3, 0.3), draw.uniform(0.03, 0.3)
    depth, has_shadow = draw.uniform(0.1, 0.4), draw.random() < 0.5
    if has_shadow if shadow is None else shadow:
        light = light * (1 - depth * ndtr((x * np.cos(turn) + y * np.sin(turn) - position) / soft))
        drawn["shadow"] = depth
    picture = camera.expected(chart) * light
    turn, deep, wide = draw.uniform(0, 2 * np.pi), draw.uniform(0.05, 0.2), draw.uniform(0.05, 0.15)
    skin, has_hand = draw.uniform(0.2, 0.6), draw.random() < 0.4
    if has_hand if hand is None else hand:
        # a thumb or a hand that comes in over the page's border, somewhere between the directions of its corners
        c, s, (page_w, page_h) = np.cos(turn), np.sin(turn), page
        out = min(0.5 * page_w / max(abs(c), 1e-9), 0.5 * page_h / max(abs(s), 1e-9))
        at_x, at_y = camera.sensor_of(page_w / 2 + out * c, page_h / 2 + out * s)
        in_x, in_y = camera.sensor_of(page_w / 2, page_h / 2)
        size, towards = pixels / camera.width, np.arctan2(at_y - in_y, at_x - in_x)
        px, py = x - at_x / camera.width + 0.5, y - (at_y - camera.height / 2) / camera.width
        along = (px * np.cos(towards) + py * np.sin(towards)) / size
        across = (py * np.cos(towards) - px * np.sin(towards)) / size
        covered = gaussian_filter(((along / deep) ** 2 + (across / wide) ** 2 < 1).astype(float), camera.sigma)
        picture = picture * (1 - covered) + skin * light * covered
        drawn["hand"] = float(covered.mean())
    snr = draw.uniform(40, 120)
    counts = draw.poisson(picture * snr**2).astype(float)
    names = ("tilt", "roll", "distance", "distortion", "vignetting", "sigma", "sag", "gamma", "table")
    drawn |= {name: getattr(camera, name) for name in names} | {"snr": snr, "size": (camera.width, camera.height)}
    return Frame(counts, camera, drawn)
