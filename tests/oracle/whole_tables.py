"""Whole recorded tables of spheres on the MERL grid (docs/model.md 3, 8), with noise and with their truth.

Imports nothing of the package. A material is a sum of terms (`Facets`, `Base`, `Body`). A term is a record of F = 1 times a
factor of each slice and channel, so all channels of a table cost one record.

A cell is the mean of the pixels at its two positions (reciprocity). All cells above the horizon have a value, those at
limb and terminator too.
"""

import zlib
from typing import NamedTuple

import numpy as np

from tests.oracle.merl_lobe import PHI_D, THETA_D, THETA_H, conductor
from tests.oracle.sphere_cells import EPD, GGX, Lobes, Setup, Tails, airy, coma, disc
from tests.oracle.sphere_slice import Slices


class Facets(NamedTuple):
    """Microfacets of a lobe. n, k: refractive index of each channel."""

    lobe: object
    n: tuple
    k: tuple = (0.0, 0.0, 0.0)

    def light(self, s2, cos_i, cos_o):
        """The BRDF times 4 cos_i cos_o, at a factor of 1."""
        return _facets(self.lobe, s2, cos_i, cos_o)

    def factor(self, theta_d):
        """Factor of each slice and channel."""
        return conductor(theta_d[:, None], np.array(self.n), np.array(self.k))


class Base(NamedTuple):
    """Microfacets of constant reflectance (channels) below a coat of a refractive index, which light crosses twice."""

    lobe: object
    reflectance: tuple
    coat: float

    def light(self, s2, cos_i, cos_o):
        return _facets(self.lobe, s2, cos_i, cos_o) * _transmitted(cos_i, self.coat) * _transmitted(cos_o, self.coat)

    def factor(self, theta_d):
        return np.broadcast_to(self.reflectance, (theta_d.size, 3))


class Body(NamedTuple):
    """Diffuse reflection of an albedo (channels) below a smooth surface of a refractive index, which light crosses twice."""

    albedo: tuple
    surface: float

    def light(self, s2, cos_i, cos_o):
        crossed = _transmitted(cos_i, self.surface) * _transmitted(cos_o, self.surface)
        return 4 * cos_i * cos_o * crossed / np.pi

    def factor(self, theta_d):
        return np.broadcast_to(self.albedo, (theta_d.size, 3))


def _facets(lobe, s2, cos_i, cos_o):
    return lobe.p22(s2) * (1 + s2) ** 2 / (1 + lobe.smith(cos_i) + lobe.smith(cos_o))


def _transmitted(cos, n):
    """1 - F of a dielectric, in real arithmetic."""
    inner = np.sqrt(n**2 - 1 + cos**2)
    return 1 - (((cos - inner) / (cos + inner)) ** 2 + ((n**2 * cos - inner) / (n**2 * cos + inner)) ** 2) / 2


class Case(NamedTuple):
    """Material, true lens, and noise of a table.

    relative: noise of a pixel, of its value. floor: noise of a pixel, of the largest value of its slice. gain: error
    of a slice, of its values. stated: specified width of a Gaussian lens, px, and its relative standard deviation;
    None: not specified.
    """

    name: str
    terms: tuple
    setup: Setup = Setup()
    stated: tuple | None = None
    relative: float = 0.01
    floor: float = 1e-4
    gain: float = 0.01


class WholeTable(NamedTuple):
    """Tables (90, 90, 180, 3), 1/sr, NaN below the horizon: recorded with noise and without it, and the material's own."""

    recorded: np.ndarray
    clean: np.ndarray
    true: np.ndarray
    case: Case


_CHROMIUM = (2.9, 2.9, 2.9), (4.23, 4.23, 4.23)
_COPPER = (0.21, 0.96, 1.18), (3.67, 2.58, 2.45)
_ALUMINIUM = (1.56, 1.02, 0.65), (7.71, 6.63, 5.32)
_SILVER = (0.16, 0.13, 0.14), (4.01, 3.26, 2.37)
_PLASTIC = (1.5, 1.5, 1.5)
_KNOWN = 0.5, 0.03


def _metal(lobe, metal):
    return (Facets(lobe, *metal),)


CASES = (
    Case("long tails", _metal(Tails(0.005, 1.7), _COPPER)),
    Case("coma", _metal(GGX(0.004), _CHROMIUM), coma(0.5, angle=0.6)),
    Case("plastic", (Facets(EPD(0.003, 1.0), _PLASTIC), Body((0.1, 0.3, 0.5), 1.5)), stated=_KNOWN),
    Case("two lobes", _metal(Lobes(((0.6, GGX(0.003)), (0.4, GGX(0.03)))), _ALUMINIUM), stated=_KNOWN),
    Case("aluminium", _metal(GGX(0.004), _ALUMINIUM), stated=_KNOWN, floor=1e-5),
    Case("silver", _metal(GGX(0.006), _SILVER), stated=_KNOWN),
    Case("no noise", _metal(GGX(0.004), _CHROMIUM), stated=_KNOWN, relative=0.0, floor=0.0, gain=0.0),
    Case("underflow", _metal(EPD(0.002, 1.0), _CHROMIUM), floor=0.0, gain=0.0),
    Case("clear coat", (Facets(EPD(0.002, 1.0), _PLASTIC), Base(GGX(0.15), (0.5, 0.3, 0.1), 1.5)), stated=_KNOWN),
    Case("Airy", _metal(GGX(0.004), _CHROMIUM), airy(0.5), _KNOWN),
    Case("disc", _metal(GGX(0.004), _CHROMIUM), disc(0.5), _KNOWN),
    Case("lens wider", _metal(GGX(0.005), _COPPER), Setup(0.65), _KNOWN),
    Case("lens narrower", _metal(GGX(0.005), _COPPER), Setup(0.35), _KNOWN),
    Case("Gaussian GGX", _metal(GGX(0.005), _CHROMIUM), Setup(0.515), _KNOWN),
)


def case_of(name):
    """Case of this name."""
    return next(case for case in CASES if case.name == name)


def simulate(case, seed=0):
    """Whole table of a case. seed: of the noise."""
    return assemble(case, records(case), seed)


def assemble(case, recorded_terms, seed=0):
    """Whole table of a case from the records of its terms (`records`)."""
    pairs = _channels(case, recorded_terms)
    return WholeTable(noisy(case, pairs, seed), pairs.mean(-2), truth(case), case)


def records(case, slices=None):
    """Records of each term at a factor of 1 (terms, 90, slices, 180, 2), 1/sr, at both positions of each cell.

    slices: indices of theta_d. Default: all.
    """
    rules = Slices(case.setup, _light(case), finest(case))
    chosen = np.arange(90) if slices is None else np.asarray(slices)
    out = np.full((len(case.terms), 90, chosen.size, 180, 2), np.nan)
    for n, j in enumerate(chosen):
        x, y, cos_i, cos_o = (a[..., 0] for a in positions(THETA_D[j]))
        used = (cos_i > 0) & (cos_o > 0)
        above = np.full((len(case.terms), 90, 180, 2), np.nan)
        above[:, used] = rules.records(THETA_D[j], x[used], y[used]) / cos_i[used][:, None]
        # the second position of a cell is the mirror image of the first position of the cell at pi - phi_d
        out[:, :, n, :, 0], out[:, :, n, :, 1] = above[..., 0], above[:, :, ::-1, 1]
    return out


def positions(theta_d):
    """Sensor positions x, y (px at a radius of 256) and cosines of lamp and camera there, each (90, 180, 2)."""
    th, psi = THETA_H[:, None, None], np.pi - PHI_D[:, None] + np.array([0, np.pi])
    x = 256.0 * (np.cos(th) * np.sin(theta_d) + np.sin(th) * np.cos(psi) * np.cos(theta_d))
    y = 256.0 * np.sin(th) * np.sin(psi)
    mean, half = np.cos(th) * np.cos(theta_d), np.sin(th) * np.sin(theta_d) * np.cos(psi)
    return x, y, mean + half, mean - half


def truth(case):
    """The material's own table (90, 90, 180, 3), 1/sr."""
    th, td, ph = THETA_H[:, None, None], THETA_D[:, None], PHI_D
    mean, half = np.cos(th) * np.cos(td), np.sin(th) * np.sin(td) * np.cos(ph)
    cos_i, cos_o = mean - half, mean + half
    used = (cos_i > 0) & (cos_o > 0)
    s2 = np.broadcast_to(np.tan(th) ** 2, used.shape)[used]
    terms = np.full((len(case.terms), *used.shape, 1), np.nan)
    terms[:, used, 0] = _light(case)(s2, cos_i[used], cos_o[used]) / (4 * cos_i[used] * cos_o[used])
    return _channels(case, terms)[..., 0, :]


def noisy(case, pairs, seed=0):
    """Table (90, 90, 180, 3) of cells, means of pairs (90, 90, 180, 2, 3) of pixels, each with its pixel's noise.

    Cells of one pixel share its noise. Each slice and channel has a gain error.
    """
    random = np.random.default_rng([seed, zlib.crc32(case.name.encode())])
    out = np.empty(pairs.shape[:3] + pairs.shape[4:])
    for j in range(90):
        x, y, _, _ = positions(THETA_D[j])
        pair = pairs[:, j]
        _, index = np.unique(np.rint(x) * 4096 + np.rint(y), return_inverse=True)
        index = index.reshape(x.shape)
        e = random.standard_normal((2, index.max() + 1, 3))
        peak = np.nanmax(pair.mean(-2), axis=(0, 1))
        values = (pair * (1 + case.relative * e[0][index]) + case.floor * peak * e[1][index]).mean(-2)
        out[:, j] = values * (1 + case.gain * random.standard_normal(3))
    return out


def finest(case):
    """Slope below which no lobe of a case has structure."""
    lobes = [term.lobe for term in case.terms if hasattr(term, "lobe")]
    single = [part for lobe in lobes for part in ([p for _, p in lobe.parts] if isinstance(lobe, Lobes) else [lobe])]
    return min(lobe[0] for lobe in single) / 10


def _light(case):
    return lambda s2, cos_i, cos_o: np.stack([term.light(s2, cos_i, cos_o) for term in case.terms])


def _channels(case, terms):
    """Sum of terms (terms, 90, 90, 180, positions) over their factors: (90, 90, 180, positions, 3)."""
    factors = np.array([term.factor(THETA_D) for term in case.terms])
    return sum(values[..., None] * factor[:, None, None] for values, factor in zip(terms, factors, strict=True))
