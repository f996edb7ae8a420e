"""Photographs of a sphere under several lamps: cases, pictures, and the table that a plain lookup reads in them.

Imports nothing of the package under test. The camera and the lamps are distant. The lamps stand to the right of the camera, at
angles of 2 theta_d. A photograph is exposed once: it has photon noise and read noise, and its light has a gain error.
"""

import hashlib
import os
import zlib
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from benchmarks.recovery import cases, generate, records
from benchmarks.recovery.cases import RADIUS, RecoveryCase, metal
from tests.oracle import real_pixels, sphere_cells
from tests.oracle.merl_lobe import PHI_D, THETA_D, THETA_H
from tests.oracle.sphere_cells import EPD, GGX, Lobes, Setup, Tails
from tests.oracle.whole_tables import Body, Case, Facets, finest, truth

RULE = "photographs"
"""Rule of a case whose entrants receive photographs and not a table."""
SLICES = np.arange(2, 75, 9)
"""Slices of theta_d that have a photograph: 2.5 to 74.5 degrees. Beyond, the highlight is too close to the limb."""
SIZE = 264
"""Half width of a photograph, px: the sphere and a margin of 8 px."""
SPILL = 5.0
"""Distance from the lit part of the sphere, px, up to which pixels record light: the kernel is below 1e-10 there."""
_LIGHT = {"relative": 0.005, "floor": 5e-5, "gain": 0.01}
"""Noise of the brightest pixel (40 000 electrons), read noise over its value (2 electrons), and gain error of a photograph."""


class Photographs(NamedTuple):
    """Photographs (lamps, rows, columns, 3) of one case, radiance per unit irradiance, 1/sr: with noise, and without.

    unit: electrons of a value of 1. read: standard deviation of the read noise, electrons.
    """

    noisy: np.ndarray
    clean: np.ndarray
    unit: float
    read: float


def is_photographs(case):
    """Whether the entrants of a case receive photographs."""
    return case.rule == RULE


def _case(name, terms, setup, stated, lens, phase):
    return RecoveryCase(Case(name, terms, setup, stated, **_LIGHT), lens, RULE, phase)


def _public():
    plastic = (Facets(EPD(0.003, 1.0), cases.PLASTIC), Body((0.1, 0.3, 0.5), 1.5))
    two = Lobes(((0.6, GGX(0.003)), (0.4, GGX(0.03))))
    gauss, aligned = "Gaussian", Setup(0.5)
    return (
        _case("sphere-metal", metal(GGX(0.005), cases.CHROMIUM), aligned, (0.485, 0.03), gauss, (0.31, -0.22)),
        _case("sphere-plastic", plastic, aligned, cases.KNOWN, gauss, (-0.12, 0.43)),
        _case("sphere-long-tails", metal(Tails(0.005, 1.7), cases.COPPER), aligned, cases.ROUGHLY, gauss, (0.05, 0.26)),
        _case("sphere-two-lobes", metal(two, cases.ALUMINIUM), aligned, cases.KNOWN, gauss, (-0.37, -0.08)),
        _case("sphere-unknown-lens", metal(EPD(0.004, 1.0), cases.GOLD), Setup(0.6), None, gauss, (0.18, 0.49)),
        _case("sphere-airy", metal(GGX(0.004), cases.SILVER), sphere_cells.airy(0.5), cases.KNOWN, "Airy", (-0.45, 0.14)),
    )  # fmt: skip


PUBLIC = _public()
"""The public cases, whose truth is published."""


def hidden_case(seed):
    """Case drawn from a seed: material, lens and noise of the hidden table of this seed, at another phase."""
    case = cases.hidden_case(seed)
    random = np.random.default_rng(np.frombuffer(hashlib.sha256(b"photographs" + seed.encode()).digest(), np.uint32))
    name = case.name.replace("hidden-", "hidden-sphere-")
    phase = tuple(float(p) for p in random.uniform(-0.5, 0.5, 2))
    return case._replace(table=case.table._replace(name=name), rule=RULE, phase=phase, rule_stated=True)


def stated(case, made):
    """Everything that an entrant is told about a case, as plain data. Columns increase to the right, rows downwards."""
    facts = cases.stated(case)
    del facts["cell_value"]
    facts["sphere"]["centre_px"] = [SIZE - case.phase[0], SIZE + case.phase[1]]
    return facts | {
        "lamp_angle_deg": (2 * np.degrees(THETA_D[SLICES])).round(9).tolist(),
        "electrons_per_value": made.unit,
        "read_noise_electrons": made.read,
        "gain_relative_standard_deviation": case.table.gain,
    }


def sources():
    """Bytes of the files on which photographs depend besides those of `records.fingerprint`."""
    return Path(__file__).read_bytes()


def photographs(case, folder=generate.FOLDER):
    """Photographs of a case; its records are read from the folder, or made and kept there."""
    name = hashlib.sha256(records.fingerprint(case).encode() + sources()).hexdigest()[:16]
    path = Path(folder) / "records" / f"photographs-{name}.npz"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = path.with_name(f"{path.stem}.{os.getpid()}.partial.npz")
        np.savez(temporary, **{str(j): records_of(case, j, positions(case, j)) for j in SLICES})
        temporary.replace(path)
    with np.load(path) as file:
        return exposed(case, {int(name): file[name] for name in file.files})


def positions(case, j):
    """Positions (pixels, 2), px, of the pixels that record light in slice j: x to the lamp, y upwards, from the centre."""
    x, y = (line + shift for line, shift in zip(_grid(), case.phase, strict=True))
    dark = -np.cos(2 * THETA_D[j]) * np.sqrt(np.maximum(RADIUS**2 - y**2, 0))
    used = (np.hypot(x, y) < RADIUS + SPILL) & (x > dark - SPILL)
    return np.stack([x[used], y[used]], -1)


def _grid():
    """Positions of all pixels without the phase, px."""
    line = np.arange(-SIZE, SIZE + 1.0)
    return np.meshgrid(line, -line)


def records_of(case, j, position):
    """Records (terms, positions) of pixels of slice j at a factor of 1: radiance per unit irradiance, 1/sr."""

    def light(s2, cos_i, cos_o):
        return np.stack([term.light(s2, cos_i, cos_o) for term in case.table.terms])

    rules = records.sphere_slice.Slices(case.table.setup, light, finest(case.table))
    both = rules.records(THETA_D[j], position[:, 0], np.abs(position[:, 1]))
    return np.where(position[:, 1] >= 0, both[..., 0], both[..., 1])


def exposed(case, kept):
    """Photographs of a case from the records {slice: (terms, pixels)}."""
    clean = np.zeros((len(SLICES), 2 * SIZE + 1, 2 * SIZE + 1, 3))
    factors = [term.factor(THETA_D) for term in case.table.terms]
    for n, j in enumerate(SLICES):
        position = positions(case, j)
        column, row = (np.rint(u).astype(int) for u in (position - case.phase).T * [[1], [-1]])
        values = sum(one[:, None] * factor[j] for one, factor in zip(kept[j], factors, strict=True))
        clean[n, row + SIZE, column + SIZE] = values
    random = np.random.default_rng(zlib.crc32(case.name.encode()))
    unit = float(1 / (case.table.relative**2 * clean.max()))
    read = case.table.floor / case.table.relative**2
    gain = 1 + case.table.gain * random.standard_normal(len(SLICES))
    electrons = random.poisson(unit * gain[:, None, None, None] * np.maximum(clean, 0)).astype(float)
    electrons += read * random.standard_normal(electrons.shape)
    return Photographs(electrons / unit, clean, unit, read)


def looked_up(pictures, facts):
    """Table (90, 90, 180, 3), 1/sr, that a plain lookup reads in photographs: radiance over the cosine of the light.

    A value is interpolated between the four pixels at each position of a cell. Between photographs, the value times both
    cosines is interpolated linearly in theta_d: a lobe without these cosines varies less. Beyond the photographs the nearest
    one is used. A value is missing where no pixel is lit.
    """
    phase = SIZE - facts["sphere"]["centre_px"][0], facts["sphere"]["centre_px"][1] - SIZE
    both = _cosines()
    read = np.empty((90, len(SLICES), 180, 3))
    for n, (j, picture) in enumerate(zip(SLICES, pictures, strict=True)):
        share, row, column, cosine = _pixels_of_cells(phase, j)
        value = np.einsum("cp,cpk->ck", share, picture[row, column] / cosine[..., None])
        read[:, n] = np.where(share.any(1)[:, None], value, np.nan).reshape(90, 180, 3) * both[:, j, :, None]
    before, share = _bracket()
    between = (1 - share)[:, None, None] * read[:, before] + share[:, None, None] * read[:, before + 1]
    return between / both[..., None]


@cache
def _cosines():
    """Product of the cosines of lamp and camera (90, 90, 180); NaN where a cell is not lit."""
    mean = np.cos(THETA_H)[:, None, None] * np.cos(THETA_D)[:, None]
    half = np.sin(THETA_H)[:, None, None] * np.sin(THETA_D)[:, None] * np.cos(PHI_D)
    return np.where(mean > np.abs(half), mean**2 - half**2, np.nan)


def _bracket():
    """Index of the photograph before each slice, and share of the one after it."""
    at = np.clip((np.arange(90) - SLICES[0]) / (SLICES[1] - SLICES[0]), 0, len(SLICES) - 1)
    before = np.minimum(at.astype(int), len(SLICES) - 2)
    return before, at - before


@cache
def _pixels_of_cells(phase, j):
    """Shares, rows, columns and cosines of the light (cells, pixels) of the pixels behind the cells of slice j."""
    th, ph = (a.ravel() for a in np.broadcast_arrays(THETA_H[:, None], PHI_D))
    found = real_pixels.behind("bilinear", np.array(phase), th, THETA_D[j], ph)
    used = found.share > 0
    column, row = (np.where(used, np.rint(u).astype(int), 0) for u in np.moveaxis(found.position - phase, -1, 0))
    cosine = np.where(used, real_pixels.light_cosine(found.position, THETA_D[j]), 1)
    return found.share, SIZE - row, SIZE + column, cosine


def table(case, made):
    """Table with which an answer is compared: what a plain lookup reads in the photographs, and the truth.

    Cells are judged where theta_d lies within the range of the photographs, and where the pixels of the cell lie EDGE px inside
    limb and terminator in both neighbouring photographs. Beyond the range nothing is recorded.
    """
    facts, seen = stated(case, made), generate.judged_cells()
    recorded, clean = (looked_up(pictures, facts) for pictures in (made.noisy, made.clean))
    beyond = (np.arange(90) < SLICES[0]) | (np.arange(90) > SLICES[-1])
    recorded[:, beyond] = clean[:, beyond] = np.nan
    before, _ = _bracket()
    judged = seen & seen[:, SLICES[before]] & seen[:, SLICES[before + 1]] & ~beyond[:, None]
    return generate.Table(recorded, clean, truth(case.table), judged)
