"""Reconstruct captures drawn at random, and judge what comes out: lobes, metals, roughness and nuisances as in the field.

    PYTHONPATH=.:src python -m tests.reconstruction.captures 40 [FIRST]    one JSON line for each capture, then a summary

18 lamps from 5 to 82 degrees, 5 exposures, a mosaic with photon and read noise, lamps at 25 and the camera at 40 radii, spheres
of 300 to 400 px, a lamp table wrong by 0.3 degrees, shifts of 0.2 px, gains of 0.5 %, a lens of 0.5 px known to 3 %. About a
minute each.
"""

import json
import sys
import tempfile

import numpy as np

from matcam import EPD, GGX, Conductor, Microfacet, reconstruct
from matcam.core.grid import merl_grid
from tests.oracle.capture import METALS, draw
from tests.oracle.sphere_picture import Surface, View, fresnel

_NAMES, _FAMILIES = ("Cr", "Au", "glass"), ("ggx", "ggx", "epd")
_NORMAL = np.radians(np.arange(10, 50, 5))


def drawn(number):
    """Capture of a number, and the surface that it shows."""
    random = np.random.default_rng(1000 + number)
    name, family = _NAMES[number % 3], _FAMILIES[number // 3 % 3]
    alpha = float(np.exp(random.uniform(np.log(0.001), np.log(0.1))))
    power = float(random.uniform(0.6, 1.3)) if family == "epd" else 1.0
    diffuse = float(random.uniform(0.05, 0.4)) if name == "glass" else 0.0
    surface = Surface(family, alpha, power, *METALS[name], (diffuse,))
    radius = float(random.uniform(300, 400))
    size = int(2 * radius + 100)
    column, row = size / 2 + random.uniform(-3, 3), size / 2 + random.uniform(-3, 3)
    view = View(radius=radius, column=column, row=row, shape=(size, size))
    azimuth = float(random.uniform(0, 2 * np.pi))
    return draw(surface, view, azimuth=azimuth, seed=number, reference=None), surface, view


def judged(number):
    """Errors of a reconstruction, relative where their names have no unit; `ratio` has pairs of error and stated error."""
    capture, surface, view = drawn(number)
    with tempfile.TemporaryDirectory() as folder:
        capture.write(folder)
        result = reconstruct(folder)
    truth = {lamp["lamp"]: lamp["direction"] for lamp in capture.truth["lamps"]}
    lamps = np.array([truth[name] for name in result.fit.names])
    off = np.degrees(np.arccos(np.clip((result.fit.lamps * lamps).sum(1), -1, 1)))
    outline = result.captured.outline
    found, std = result.parameters[result.fit.kind.family_names[0]]
    ratios = []
    for channel in range(3):
        n, k = (np.array(values)[min(channel, len(values) - 1)] for values in (surface.n, surface.k))
        true = fresnel(np.cos(np.radians(75)), n, k) / np.mean(fresnel(np.cos(_NORMAL), n, k))
        ratio = result.ratio(np.radians(75), channel)
        ratios.append([ratio.value / true - 1, ratio.std / ratio.value])
    supported, false, peaks = _entries(result.table, surface)
    return {
        "number": number, "family": surface.family, "alpha": surface.alpha, "fitted": result.fit.kind.family,
        "pictures": len(result.fit.names), "ratio": ratios, "roughness": [found / surface.alpha - 1, std / surface.alpha],
        "lamps_deg": float(np.sqrt(np.mean(off**2))),
        "outline_px": [outline.column - view.column, outline.row - view.row, outline.radius - view.radius],
        "supported": supported, "false": false, "peaks": peaks, "remarks": sorted({one.code for one in result.remarks}),
    }  # fmt: skip


def _entries(table, surface):
    """How many entries of the green channel are supported, how many of them err by over 3 std, and errors of supported peaks.

    The table is relative: its scale is that of the supported entries at 30 degrees or the first slice that has any.
    """
    grid, green = merl_grid("centre"), 1
    lobe = GGX(surface.alpha) if surface.family == "ggx" else EPD(surface.alpha, surface.power)
    n, k = (np.array(values)[min(green, len(values) - 1)] for values in (surface.n, surface.k))
    material = Microfacet(lobe, Conductor(n, k), surface.diffuse[0])
    scale, supported, false, peaks = None, 0, 0, []
    for degrees in (30, *range(8, 81, 6)):
        j = grid.index(theta_d=np.radians(degrees))[1]
        true = np.asarray(material.brdf(grid.theta_h[:, None], grid.theta_d[j], grid.phi_d[None, ::20]))
        value, std, known = (
            part.values[:, j, ::20, green] for part in (table.brdf, table.brdf_std, table.supported.astype(bool))
        )
        known &= np.isfinite(true) & (true > 0)
        if not known.any():
            continue
        scale = np.median(value[known] / true[known]) if scale is None else scale
        supported += int(known.sum())
        false += int((np.abs(value - scale * true) > 3 * std)[known].sum())
        if known[0, 0]:
            peaks.append(float(value[0, 0] / scale / true[0, 0] - 1))
    return supported, false, peaks


def summary(found):
    """What all captures together say."""
    error, std = np.moveaxis(np.array([one["ratio"] for one in found]), -1, 0)
    roughness = np.array([one["roughness"] for one in found])
    supported = sum(one["supported"] for one in found)

    def rms(values):
        return float(np.sqrt(np.mean(np.square(values))))

    return {
        "captures": len(found),
        "ratio_rms": rms(error),
        "ratio_worst": float(np.abs(error).max()),
        "ratio_pull": rms(error / std),
        "within_1_std": float(np.mean(np.abs(error) < std)),
        "roughness_rms": rms(roughness[:, 0]),
        "roughness_pull": rms(roughness[:, 0] / roughness[:, 1]),
        "lamps_deg": rms([one["lamps_deg"] for one in found]),
        "outline_px": rms([one["outline_px"] for one in found]),
        "false": sum(one["false"] for one in found) / max(supported, 1),
        "peaks_worst": max((abs(peak) for one in found for peak in one["peaks"]), default=0.0),
    }


if __name__ == "__main__":
    count, first = int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0
    everything = []
    for one in range(first, first + count):
        everything.append(judged(one))
        print(json.dumps(everything[-1], default=float), flush=True)
    print(json.dumps(summary(everything)))
