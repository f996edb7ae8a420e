"""Tables of materials, lenses and cells drawn at random, recorded by the oracle: what a correction is judged by.

Imports nothing of the package. A number draws a material (lobes of one family, with tails, or of two; metals, and dielectrics
over a Lambertian body, which light may reach through the dielectric's surface), a lens (Gaussian, disc, coma, an Airy disc; its
width off from what is stated), and how cells are read (pixels of their own, the nearest of a real grid, or interpolated). Every
pixel has 1 % of noise and 1e-4 of its picture's peak, every picture a gain of 1 %.

A whole table is too dear: a table holds given cells, and judged ones of three kinds in each of its slices.
"""

from typing import NamedTuple

import numpy as np

from tests.oracle import sphere_cells as oracle
from tests.oracle.merl_lobe import PHI_D, THETA_D, THETA_H, conductor
from tests.oracle.real_pixels import RealTable

FAMILIES = ("ggx", "beckmann", "tails", "epd", "mixture")
LENSES = ("gaussian", "gaussian", "gaussian", "disc", "coma", "gaussian", "airy")
RULES = ("centre", "nearest", "bilinear")
METALS = {"Cr": (2.9, 4.23), "Au": (0.31, 2.88), "Al": (0.96, 6.69)}
STATED = 0.5
"""px; width of the lens that is stated."""
NOISE = {"relative": 0.01, "floor": 1e-4, "gain": 0.01}
KINDS = ("peak", "slope", "tail")
LEAST = (0.5, 0.01, 0.0)
"""Share of the facets at the lobe's middle down to which an entry is of a kind."""
EACH = 8
"""Judged entries of each kind in a slice."""
_LOWEST = 0.12


class Draw(NamedTuple):
    """family, lobe; n, k; body: albedo of the Lambertian part; coated: light crosses the surface to the body and back; lens,
    setup: the true ones; known: relative standard deviation of the lens's stated width; rule, phase (px) of the cells; told:
    whether the rig says the rule."""

    number: int
    family: str
    lobe: object
    n: float
    k: float
    body: float
    coated: bool
    lens: str
    setup: oracle.Setup
    known: float
    rule: str
    phase: tuple
    told: bool


def _one(random, family, alpha):
    if family == "ggx":
        return oracle.GGX(alpha)
    if family == "tails":
        return oracle.Tails(alpha, float(random.uniform(1.6, 3.5)))
    return oracle.EPD(alpha, 1.0 if family == "beckmann" else float(np.exp(random.uniform(*np.log([0.5, 2.0])))))


def drawn(number):
    """Draw of a number. Each family meets each lens, 3 % and 30 %, and each rule in turn."""
    random = np.random.default_rng(21_000 + number)
    family, lens, rule = FAMILIES[number % 5], LENSES[number % 7], RULES[number % 3]
    known = 0.03 if number % 4 < 2 else 0.3
    alpha = float(np.exp(random.uniform(*np.log([0.0007, 0.3]))))
    if family == "mixture":
        alpha = min(alpha, 0.1)
        wide = min(alpha * float(np.exp(random.uniform(*np.log([2.0, 30.0])))), 0.5)
        share = float(random.uniform(0.2, 0.8))
        pair = [_one(random, ("ggx", "beckmann")[random.integers(2)], width) for width in (alpha, wide)]
        lobe = oracle.Lobes(((share, pair[0]), (1 - share, pair[1])))
    else:
        lobe = _one(random, family, alpha)
    if random.random() < 0.5:
        (n, k), body = METALS[str(random.choice(list(METALS)))], 0.0
    else:
        n, k, body = float(random.uniform(1.3, 1.8)), 0.0, float(random.uniform(0.05, 0.5))
    least = 0.15 if lens == "gaussian" else 0.3
    sigma = float(np.clip(STATED * (1 + known * random.standard_normal()), least, 0.85))
    setup = {
        "gaussian": lambda: oracle.Setup(sigma),
        "disc": lambda: oracle.disc(sigma),
        "coma": lambda: oracle.coma(sigma, float(random.uniform(0, 2 * np.pi))),
        "airy": lambda: oracle.airy(sigma),
    }[lens]()
    phase = (0.0, 0.0) if rule == "centre" else tuple(float(p) for p in random.uniform(-0.5, 0.5, 2))
    told, coated = bool(random.random() < 0.5), bool(random.random() < 0.5)
    return Draw(number, family, lobe, n, k, body, body > 0 and coated, lens, setup, known, rule, phase, told)


def crossed(draw):
    """Share of the light that the surface above the body transmits, as a function of the cosine."""
    if not draw.coated:
        return lambda cosine: 1.0
    return lambda cosine: 1 - conductor(np.arccos(np.clip(cosine, 0, 1)), draw.n, 0.0)


def facets(lobe, i):
    """D at rings, over that at the middle."""
    s2 = np.tan(THETA_H[i]) ** 2
    return lobe.p22(s2) * (1 + s2) ** 2 / lobe.p22(1e-24)


def judged(draw, slices):
    """(kind, ring, azimuth) of the entries to look at, (slices, entries) each: of every kind that a slice has as many."""
    random = np.random.default_rng(22_000 + draw.number)
    share = facets(draw.lobe, np.arange(90))
    kinds = np.select([share >= LEAST[0], share >= LEAST[1]], [0, 1], 2)
    found = []
    for j in slices:
        mean = np.cos(THETA_H)[:, None] * np.cos(THETA_D[j])
        half = np.sin(THETA_H)[:, None] * np.sin(THETA_D[j]) * np.abs(np.cos(PHI_D))
        shown = mean - half > _LOWEST
        rows = []
        for kind in range(3):
            rings = np.flatnonzero((kinds == kind) & shown.any(1))
            for _ in range(EACH):
                i = random.choice(rings) if rings.size else 0
                rows.append(
                    (
                        kind if rings.size else kinds[0],
                        i,
                        random.choice(np.flatnonzero(shown[i])) if shown[i].any() else 90,
                    )
                )
        found.append(rows)
    return np.moveaxis(np.array(found), -1, 0)


def truth(draw, slices, i, k):
    """The material itself in cells (slices, cells), 1/sr."""
    th, td, ph = THETA_H[i], THETA_D[slices][:, None], PHI_D[k]
    mean, half = np.cos(th) * np.cos(td), np.sin(th) * np.sin(td) * np.cos(ph)
    cosines = mean - half, mean + half
    tan2 = np.tan(th) ** 2
    hidden = 1 + sum(draw.lobe.smith(np.clip(c, 1e-6, 1)) for c in cosines)
    with np.errstate(divide="ignore", invalid="ignore"):
        lobe = draw.lobe.p22(tan2) * (1 + tan2) ** 2 / hidden / (4 * cosines[0] * cosines[1])
    through = crossed(draw)
    value = lobe * conductor(td, draw.n, draw.k) + draw.body / np.pi * through(cosines[0]) * through(cosines[1])
    return np.where((cosines[0] > 0) & (cosines[1] > 0), value, np.nan)


def finest(lobe):
    """Slope below which a lobe has no structure."""
    widths = [one[0] for _, one in lobe.parts] if isinstance(lobe, oracle.Lobes) else [lobe[0]]
    return min(widths) / 10


def recorded(draw, slices, i, k):
    """(without noise, with it): what is recorded in cells (slices, cells) of a table, 1/sr."""
    random = np.random.default_rng(23_000 + draw.number)
    theta_d = THETA_D[slices]
    f = conductor(theta_d, draw.n, draw.k)
    if draw.rule == "centre":
        rule = oracle.Cells(THETA_H[i], theta_d, PHI_D[k], draw.setup, finest=finest(draw.lobe))
        directions = f[:, None, None] * rule.directions(draw.lobe) + draw.body * rule.body(crossed(draw))
        return directions.mean(-1), rule.noisy(directions, random, **NOISE)
    cells = [(THETA_H[a], PHI_D[b]) for a, b in zip(i, k, strict=True)]
    table = RealTable(draw.rule, draw.phase, theta_d, cells, draw.setup, finest(draw.lobe))
    pixels = f[:, None] * table.pixels(draw.lobe) + draw.body * table.rule.body(crossed(draw))[..., 0]
    return np.array(table.values(pixels)), np.array(table.values(pixels, random, **NOISE))
