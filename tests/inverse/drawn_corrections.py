"""Correct tables drawn at random, and judge what comes out: lobes, lenses, cells and materials as in the field.

    PYTHONPATH=.:src python -m tests.inverse.drawn_corrections COUNT [FIRST] [FILE]

Draws FIRST to FIRST + COUNT - 1 are made; those that FILE holds are not made again. Each is a JSON line, printed and added to
FILE. Then the figures of all lines stand there, by class. A draw holds the cells that a fit chooses in every sixth slice of
theta_d, and 24 judged entries in each of these: a whole table would take a hundred times as long.
Drawing takes 1 to 11 s of processor time, a whole draw 8 to 120 s, most about 40.
"""

import json
import sys
import time
from pathlib import Path
from unittest.mock import patch

import numpy as np
import xarray as xr

from matcam import fresnel
from matcam.core.errors import FitError
from matcam.core.jax import use_compilation_cache
from matcam.forward.pixel_grid import PixelGrid
from matcam.inverse import Correction
from matcam.inverse.correction import correction
from matcam.inverse.operator.chosen_cells import chosen_cells
from matcam.inverse.operator.sample_view import SampleView
from tests.inverse import recorded
from tests.oracle import drawn_tables as draws
from tests.oracle import sphere_cells as oracle
from tests.oracle.merl_lobe import PHI_D, THETA_D, THETA_H, conductor

EVERY = 6
WHOLE = 12
"""Rings that a table of real pixels holds whole: its phase is found there."""
_STEP = 1e-3


def cells_of(draw):
    """(slices, ring, azimuth, how many are judged): the judged cells come last."""
    view = SampleView(256.0)
    centred = chosen_cells(view, "centre", EVERY)
    some = [centred]
    if draw.rule != "centre":
        some.append(chosen_cells(view, "centre", EVERY, PixelGrid(draw.rule, draw.phase)))
    slices = centred.slices
    kind, i, k = draws.judged(draw, slices)
    rings, around = [], []
    if draw.rule != "centre":
        a, b = (part.ravel() for part in np.meshgrid(np.arange(WHOLE), np.arange(180), indexing="ij"))
        rings, around = [np.tile(a, (slices.size, 1))], [np.tile(b, (slices.size, 1))]
    for one in some:  # what fills up a slice is read at the top
        rings.append(np.where(one.valid, one.i_theta_h, 0))
        around.append(np.where(one.valid, one.i_phi_d, 90))
    if draw.rule == "centre":  # and the cells that mirror them, as a whole table has
        rings.append(rings[0])
        around.append(179 - around[0])
    return slices, np.concatenate([*rings, i], 1), np.concatenate([*around, k], 1), kind


def rig_of(draw):
    said = {"cell_value": draw.rule if draw.told else "unknown"}
    return recorded.rig(draws.STATED, std=draw.known * draws.STATED, **said)


def table_of(slices, i, k, values):
    whole = np.full((90, 90, 180, 1), np.nan)
    whole[i, np.broadcast_to(slices[:, None], i.shape), k, 0] = values
    coords = {"theta_h": THETA_H, "theta_d": THETA_D, "phi_d": PHI_D, "channel": ["G"]}
    return xr.DataArray(
        whole, dims=("theta_h", "theta_d", "phi_d", "channel"), coords=coords, attrs={"sampling": "centre"}
    )


def judged(number):
    """What a draw's correction says of its judged entries, and what is true; rows of `ENTRY`."""
    started = time.process_time()
    draw = draws.drawn(number)
    slices, i, k, kind = cells_of(draw)
    clean, values = draws.recorded(draw, slices, i, k)
    table = table_of(slices, i, k, values)
    drawn_in = time.process_time() - started
    kept = []

    def explained(*args, explain=correction.explain, **more):
        kept.append(explain(*args, **more))
        return kept[-1]

    lobe = draw.lobe.parts if draw.family == "mixture" else draw.lobe
    found = {
        "number": number, "family": draw.family, "lobe": str(lobe), "index": [draw.n, draw.k], "body": draw.body,
        "coated": draw.coated,
        "lens": draw.lens, "sigma": sigma_of(draw), "known": draw.known, "rule": draw.rule, "told": draw.told,
    }  # fmt: skip
    try:
        with patch.object(correction, "explain", explained):
            done = Correction.of(table, rig_of(draw))
        # `fresnel` of the same slices finds the same explanation: it is not made twice
        with patch("matcam.inverse.fresnel_term.explain", lambda *args, **more: kept[0]):
            curve = fresnel(table, rig_of(draw), slice_step=EVERY)
    except FitError as error:
        return {**found, "error": str(error)}
    found |= {
        "fitted": done.fit.family, "determination": done.determination, "no_camera": done.no_camera,
        "scale": done.shape.scale, "noise": done.shape.noise._asdict(),
        "remarks": sorted({one.code for one in done.remarks}), "f75": f75(draw, curve), "bound": bound(draw),
    }  # fmt: skip
    n = kind.shape[1]
    at = i[:, -n:], np.broadcast_to(slices[:, None], kind.shape), k[:, -n:], 0
    true = draws.truth(draw, slices, at[0], at[2])
    value, std, camera, supported = (
        done.table[name].values[at] for name in ("brdf", "brdf_std", "correction_std", "supported")
    )
    rows = np.stack([kind, at[1], true, clean[:, -n:], table.values[at], value, std, camera, supported], -1)
    known = np.isfinite(rows[..., :6]).all(-1) & (true > 1e-9)
    found["entries"] = [[float(f"{x:.6g}") for x in row] for row in rows[known]]
    found["seconds"] = [round(drawn_in, 1), round(time.process_time() - started, 1)]
    return found


ENTRY = ("kind", "slice", "true", "clean", "raw", "value", "std", "camera", "supported")


def sigma_of(draw):
    if not draw.setup.lens:
        return draw.setup.sigma
    rows = np.array(draw.setup.lens)
    return float(np.sqrt(draw.setup.sigma**2 + rows[:, 0] @ (rows[:, 1:] ** 2).sum(1) / 2))


def f75(draw, curve):
    """(relative error, relative standard deviation) of the F that `fresnel` states at 75.5 degrees."""
    theta_d = curve.theta_d.values
    true = conductor(theta_d, draw.n, draw.k)
    true /= true[(theta_d > np.radians(10)) & (theta_d < np.radians(45))].mean()
    at = int(np.argmin(np.abs(theta_d - np.radians(75.5))))
    value, std = (float(curve[name][at, 0]) for name in ("corrected", "corrected_std"))
    return [value / true[at] - 1, std / true[at]]


def variations(lobe, step=_STEP):
    """Lobes with each of their numbers up and down by a step of its logarithm."""
    if not isinstance(lobe, oracle.Lobes):
        fixed = isinstance(lobe, oracle.EPD) and lobe.power == 1.0  # Beckmann's
        positions = range(1 if fixed else len(lobe))
        return [
            [type(lobe)(*(v * np.exp(side * step * (a == b)) for b, v in enumerate(lobe))) for side in (1, -1)]
            for a in positions
        ]
    (share, one), (rest, other) = lobe.parts
    pairs = [[oracle.Lobes(((share, a), (rest, other))) for a in pair] for pair in variations(one)]
    pairs += [[oracle.Lobes(((share, one), (rest, a))) for a in pair] for pair in variations(other)]
    return [*pairs, [oracle.Lobes(((s, one), (1 - s, other))) for s in (share * np.exp(step), share * np.exp(-step))]]


def bound(draw):
    """(theta_d in degrees, relative standard deviation of a peak) in five slices that nobody can undercut (Cramer-Rao):
    the lobe's own numbers, strengths free in every slice, the lens a Gaussian known as stated; noise and gain."""
    cells = chosen_cells(SampleView(256.0), "centre", 3 * EVERY)
    pad = ((0, 0), (0, 1))
    th = np.pad(THETA_H[cells.i_theta_h], pad, constant_values=THETA_H[0])
    ph = np.pad(PHI_D[cells.i_phi_d], pad, constant_values=PHI_D[90])
    sigma, step = sigma_of(draw), 0.01
    rules = [
        oracle.Cells(th, cells.theta_d, ph, oracle.Setup(sigma * np.exp(side * step)), finest=draws.finest(draw.lobe))
        for side in (0, 1)
    ]
    at = rules[0].directions(draw.lobe).mean(-1)
    ones = np.zeros((cells.slices.size, 1), int)

    def top(lobe):
        return draws.truth(draw._replace(lobe=lobe, body=0.0), cells.slices, ones, ones + 90)[:, 0]

    pairs = variations(draw.lobe)
    slopes = [
        (rules[0].directions(up).mean(-1) - rules[0].directions(down).mean(-1)) / (2 * _STEP) for up, down in pairs
    ]
    tops = [(np.log(top(up)) - np.log(top(down))) / (2 * _STEP) for up, down in pairs]
    slopes.append((rules[1].directions(draw.lobe).mean(-1) - at) / step)
    tops.append(np.zeros(cells.slices.size))
    f = conductor(cells.theta_d, draw.n, draw.k)[:, None]
    body = np.nan_to_num(rules[0].body().mean(-1)) * draw.body
    usable = np.isfinite(at) & np.pad(cells.valid, pad)
    share = np.pad(np.where(cells.one_pixel, 1.0, 0.5), pad, constant_values=1.0)
    whole = np.where(usable, f * at + body, 0.0)
    std = np.sqrt(share * ((0.01 * whole) ** 2 + (1e-4 * whole.max(1, keepdims=True)) ** 2))
    weight = np.where(usable, f / np.where(usable, std, 1.0), 0.0)[:, :-1]
    columns, along = np.nan_to_num(np.array(slopes))[..., :-1] * weight, np.nan_to_num(at)[:, :-1] * weight
    of_strength = np.maximum((along**2).sum(-1), 1e-30)[:, None]
    left = columns - np.einsum("psn,sn->ps", columns, along)[..., None] * along / of_strength
    information = 3 * np.einsum("psn,qsn->pq", left, left)  # three times as many slices are corrected by
    information[-1, -1] += 1 / draw.known**2
    of_ratio = np.array(tops) - np.array(slopes)[..., -1] / at[:, -1]
    variance = np.einsum("ps,pq,qs->s", of_ratio, np.linalg.pinv(information, hermitian=True), of_ratio)
    seen = np.isfinite(variance)
    return [
        [float(d), float(v)]
        for d, v in zip(np.degrees(cells.theta_d[seen]), np.sqrt(variance[seen] + 2 * 0.01**2), strict=True)
    ]


if __name__ == "__main__":
    from tests.inverse.drawn_figures import figures, shown

    use_compilation_cache()
    count, first = int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0
    file = Path(sys.argv[3]) if len(sys.argv) > 3 else None
    lines = [json.loads(line) for line in file.read_text().splitlines()] if file and file.exists() else []
    there = {one["number"] for one in lines}
    for number in range(first, first + count):
        if number not in there:
            lines.append(judged(number))
            text = json.dumps(lines[-1], default=float)
            print({name: part for name, part in lines[-1].items() if name != "entries"}, flush=True)
            if file:
                with file.open("a") as out:
                    out.write(text + "\n")
    print(shown(figures(lines)))
