"""Cases of the benchmark: materials, lenses, cells and noise. Imports nothing of the package under test.

The 24 public cases are listed. A hidden case is drawn from a seed by `hidden_case`; `hidden.sha256` is the hash of the list of
seeds.
"""

import hashlib
from typing import NamedTuple

import numpy as np
from tests.oracle import sphere_cells as oracle
from tests.oracle.sphere_cells import EPD, GGX, Lobes, Setup, Tails
from tests.oracle.whole_tables import Base, Body, Case, Facets

RADIUS = 256.0
"""Radius of the sphere in the photographs, px."""
HALF_WIDTH = 0.5
"""Half width of a pixel's light-sensitive area, px."""
GUESS = 0.5
"""Standard deviation of the lens, px, that entrants may assume where a case does not state a lens."""


class RecoveryCase(NamedTuple):
    """A recorded table with its truth.

    table: material, true lens, stated lens, and noise. lens: kind of the true lens. rule: how a cell is looked up in the
    photograph of its slice: "centre", "nearest" or "bilinear". phase: position of the pixel grid, px. rule_stated: whether the
    rule is given to entrants. mtf: stated MTF of the lens (frequencies, values), instead of a Gaussian.
    """

    table: Case
    lens: str
    rule: str = "centre"
    phase: tuple = (0.0, 0.0)
    rule_stated: bool = True
    mtf: tuple | None = None

    @property
    def name(self):
        """Name of the case and of its files."""
        return self.table.name


CHROMIUM = (2.9, 2.9, 2.9), (4.23, 4.23, 4.23)
COPPER = (0.21, 0.96, 1.18), (3.67, 2.58, 2.45)
ALUMINIUM = (1.56, 1.02, 0.65), (7.71, 6.63, 5.32)
SILVER = (0.16, 0.13, 0.14), (4.01, 3.26, 2.37)
GOLD = (0.22, 0.42, 1.33), (3.09, 2.35, 1.83)
METALS = CHROMIUM, COPPER, ALUMINIUM, SILVER, GOLD
PLASTIC = (1.5, 1.5, 1.5)
KNOWN, ROUGHLY = (0.5, 0.03), (0.5, 0.3)
"""Stated width of the lens, px, and its relative standard deviation."""


def metal(lobe, constants):
    """Terms of a metal."""
    return (Facets(lobe, *constants),)


def measured_lens():
    """Lens with a core of 0.4 px and a surround: 80 % of the light in the core, 15 % and 5 % on rings of 1 and 2 px."""
    turn = 2 * np.pi * np.arange(8) / 8
    rows = [(0.8, 0.0, 0.0)]
    rows += [(s / 8, r * np.cos(t), r * np.sin(t)) for s, r in ((0.15, 1.0), (0.05, 2.0)) for t in turn]
    return Setup(0.4, lens=tuple((float(s), float(x), float(y)) for s, x, y in rows))


def mean_mtf(setup, frequency):
    """MTF of a lens of points, mean over the azimuth: sum of J0 (Hankel transform of rings) times the Gaussian's MTF."""
    from scipy.special import j0

    f = np.asarray(frequency)
    gaussian = np.exp(-2 * (np.pi * setup.sigma * f) ** 2)
    if not setup.lens:
        return gaussian
    share, x, y = np.array(setup.lens).T
    return gaussian * (share @ j0(2 * np.pi * np.hypot(x, y)[:, None] * f))


def stated_mtf(setup, seed):
    """MTF at 12 frequencies up to 1.65 cycles/px with smooth errors of about 1 % of the value; 0 at the end."""
    f = np.linspace(0, 1.65, 12)
    random = np.random.default_rng(seed)
    error = 0.01 * np.sin(np.pi * f[:, None] / 1.65 * np.arange(1, 4)) @ random.standard_normal(3) / np.sqrt(3)
    values = mean_mtf(setup, f) * (1 + error)
    values[-1] = 0.0
    return tuple(f.round(4).tolist()), tuple(values.round(5).tolist())


def _public():
    aligned = Setup(0.5)
    measured = measured_lens()
    two = Lobes(((0.6, GGX(0.003)), (0.4, GGX(0.03))))
    far = Lobes(((0.7, EPD(0.002, 1.0)), (0.3, GGX(0.05))))
    coated = (Facets(EPD(0.002, 1.0), PLASTIC), Base(GGX(0.15), (0.5, 0.3, 0.1), 1.5))
    lacquer = (Facets(EPD(0.004, 1.0), PLASTIC), Base(GGX(0.04), (0.9, 0.6, 0.3), 1.5))
    body = (0.1, 0.3, 0.5)
    gauss, quiet = "Gaussian", {"relative": 0.003, "floor": 1e-5, "gain": 0.003}
    loud = {"relative": 0.03, "floor": 1e-3, "gain": 0.02}
    return (
        RecoveryCase(Case("ggx-0.0007", metal(GGX(0.0007), ALUMINIUM), aligned, (0.49, 0.03)), gauss),
        RecoveryCase(Case("ggx-0.005", metal(GGX(0.005), CHROMIUM), aligned, (0.485, 0.03)), gauss),
        RecoveryCase(Case("ggx-0.03", metal(GGX(0.03), SILVER), aligned), gauss),
        RecoveryCase(Case("ggx-0.3", metal(GGX(0.3), COPPER), aligned, ROUGHLY), gauss),
        RecoveryCase(Case("ggx-quiet", metal(GGX(0.003), GOLD), aligned, (0.51, 0.03), **quiet), gauss),
        RecoveryCase(Case("ggx-loud", metal(GGX(0.006), SILVER), aligned, (0.4, 0.3), **loud), gauss),
        RecoveryCase(Case("beckmann-0.0015", metal(EPD(0.0015, 1.0), CHROMIUM), aligned, (0.52, 0.03)), gauss),
        RecoveryCase(Case("beckmann-unknown-lens", metal(EPD(0.003, 1.0), CHROMIUM), aligned), gauss),
        RecoveryCase(Case("epd-short-tails", metal(EPD(0.01, 1.6), GOLD), aligned, (0.6, 0.3)), gauss),
        RecoveryCase(Case("long-tails", metal(Tails(0.005, 1.7), COPPER), aligned), gauss),
        RecoveryCase(Case("long-tails-narrow", metal(Tails(0.0015, 1.6), ALUMINIUM), aligned, KNOWN), gauss),
        RecoveryCase(Case("two-lobes", metal(two, ALUMINIUM), aligned, KNOWN), gauss),
        RecoveryCase(Case("two-lobes-apart", metal(far, CHROMIUM), aligned, (0.45, 0.3)), gauss),
        RecoveryCase(Case("plastic", (Facets(EPD(0.003, 1.0), PLASTIC), Body(body, 1.5)), aligned, KNOWN), gauss),
        RecoveryCase(Case("paint", (Facets(GGX(0.01), (1.45,) * 3), Body((0.4, 0.1, 0.05), 1.45)), aligned), gauss),
        RecoveryCase(Case("clear-coat", coated, aligned, KNOWN), gauss),
        RecoveryCase(Case("lacquer", lacquer, aligned, ROUGHLY), gauss),
        RecoveryCase(Case("airy", metal(GGX(0.004), CHROMIUM), oracle.airy(0.5), KNOWN), "Airy"),
        RecoveryCase(Case("disc", metal(EPD(0.004, 1.0), COPPER), oracle.disc(0.5), ROUGHLY), "disc"),
        RecoveryCase(Case("coma", metal(GGX(0.004), CHROMIUM), oracle.coma(0.5, angle=0.6)), "coma"),
        RecoveryCase(
            Case("measured-lens", metal(GGX(0.003), SILVER), measured, KNOWN), "measured", mtf=stated_mtf(measured, 4)
        ),
        RecoveryCase(Case("lens-wider", metal(GGX(0.005), COPPER), Setup(0.65), KNOWN), gauss),
        RecoveryCase(
            Case("nearest-pixel", metal(GGX(0.004), CHROMIUM), aligned, (0.505, 0.03)), gauss, "nearest", (0.21, -0.34), False
        ),
        RecoveryCase(
            Case("bilinear-pixels", metal(EPD(0.005, 1.0), GOLD), aligned, ROUGHLY), gauss, "bilinear", (-0.4, 0.15)
        ),
    )  # fmt: skip


PUBLIC = _public()
"""The public cases, whose truth is published."""


def public_case(name):
    """Public case of this name."""
    return next(case for case in PUBLIC if case.name == name)


def hidden_case(seed):
    """Case drawn from a seed: a text that is not empty. Every part is drawn independently, from the ranges of public cases."""
    random = np.random.default_rng(np.frombuffer(hashlib.sha256(seed.encode()).digest(), np.uint32))
    alpha = float(np.exp(random.uniform(*np.log([0.0007, 0.3]))))
    kind = str(random.choice(["ggx", "beckmann", "epd", "tails", "two lobes"]))
    lobe = _lobe(random, kind, alpha)
    constants = METALS[int(random.integers(len(METALS)))]
    albedo = tuple(float(a) for a in random.uniform(0.02, 0.6, 3))
    index = float(random.uniform(1.35, 1.7))
    terms = (
        metal(lobe, constants),
        metal(lobe, constants),
        (Facets(lobe, (index,) * 3), Body(albedo, index)),
        (Facets(lobe, (index,) * 3), Base(GGX(min(20 * alpha, 0.3)), albedo, index)),
    )[int(random.integers(4))]
    known = (None, 0.03, 0.3)[int(random.integers(3))]
    sigma = float(np.clip(GUESS * (1 + (known or 0.3) * random.standard_normal()), 0.3, 0.85))
    lens = str(random.choice(["Gaussian", "Gaussian", "Gaussian", "Airy", "disc", "coma", "measured"]))
    angle = float(random.uniform(0, 2 * np.pi))
    setup = {
        "Gaussian": lambda: Setup(sigma),
        "Airy": lambda: oracle.airy(sigma),
        "disc": lambda: oracle.disc(sigma),
        "coma": lambda: oracle.coma(sigma, angle),
        "measured": measured_lens,
    }[lens]()
    rule = str(random.choice(["centre", "centre", "nearest", "bilinear"]))
    phase = (0.0, 0.0) if rule == "centre" else tuple(float(p) for p in random.uniform(-0.5, 0.5, 2))
    noise = {
        "relative": float(np.exp(random.uniform(*np.log([0.003, 0.03])))),
        "floor": float(np.exp(random.uniform(*np.log([1e-5, 1e-3])))),
        "gain": float(random.uniform(0, 0.02)),
    }
    name = "hidden-" + hashlib.sha256(b"name" + seed.encode()).hexdigest()[:8]
    stated = None if known is None else (GUESS, known)
    mtf = stated_mtf(setup, int(random.integers(2**31))) if lens == "measured" and known else None
    return RecoveryCase(
        Case(name, terms, setup, stated, **noise), lens, rule, phase, bool(random.random() < 0.5), mtf
    )  # fmt: skip


def _lobe(random, kind, alpha):
    if kind == "two lobes":
        alpha = min(alpha, 0.1)
        wide = min(alpha * float(np.exp(random.uniform(*np.log([2.0, 30.0])))), 0.5)
        share = float(random.uniform(0.2, 0.8))
        return Lobes(((share, GGX(alpha)), (1 - share, EPD(wide, 1.0))))
    if kind == "epd":
        return EPD(alpha, float(np.exp(random.uniform(*np.log([0.5, 2.0])))))
    if kind == "tails":
        return Tails(alpha, float(random.uniform(1.6, 3.5)))
    return GGX(alpha) if kind == "ggx" else EPD(alpha, 1.0)


def stated(case):
    """Everything that an entrant is told about a case, as plain data."""
    lens = None
    if case.mtf:
        lens = {
            "kind": "mtf", "frequency_cycles_per_px": list(case.mtf[0]), "mtf": list(case.mtf[1]),
            "relative_standard_deviation": case.table.stated[1],
        }  # fmt: skip
    elif case.table.stated:
        sigma, known = case.table.stated
        lens = {"kind": "gaussian", "sigma_px": sigma, "relative_standard_deviation": known}
    return {
        "name": case.name,
        "sphere": {"radius_px": RADIUS, "camera": "distant", "lamp": "distant point"},
        "pixel_half_width_px": HALF_WIDTH,
        "lens": lens,
        "cell_value": case.rule if case.rule_stated else "unknown",
    }


def seeds_hash(text):
    """Hash of a list of seeds, one in each line."""
    return hashlib.sha256("\n".join(text.split()).encode()).hexdigest()
