"""The package under test as an entrant: `matcam.correct` with the stated lens, and with the true one."""

import numpy as np
import xarray as xr
from benchmarks.recovery.cases import mean_mtf
from benchmarks.recovery.entries import Answer

import matcam
from matcam.camera import Uncertainty
from matcam.core.grid import brdf_table
from matcam.rigs import Rig, merl


def defaults(recorded, case, facts):
    """Answer of `matcam.correct` with the lens as stated; where none is stated, with `rigs.merl()`."""
    sphere, rule = matcam.Sphere(facts["sphere"]["radius_px"]), facts["cell_value"]
    if facts["lens"] is None:
        return answer(recorded, Rig(merl().camera, sphere, cell_value="unknown"))
    return answer(recorded, Rig(stated_camera(facts), sphere, cell_value=rule))


def stated_camera(facts):
    """Camera with the lens as stated."""
    lens, pixel = facts["lens"], matcam.BoxPixel(facts["pixel_half_width_px"])
    if lens["kind"] == "mtf":
        return matcam.Camera(matcam.MeasuredOptics(lens["frequency_cycles_per_px"], lens["mtf"]), pixel)
    known = Uncertainty.of({"optics.sigma_px": lens["sigma_px"] * lens["relative_standard_deviation"]})
    return matcam.Camera(matcam.GaussianOptics(lens["sigma_px"]), pixel, uncertainty=known)


def true_lens(recorded, case, facts):
    """Answer of `matcam.correct` with the true lens; of a lens without rotational symmetry its MTF, mean over azimuths."""
    more = {} if case.rule == "centre" else {"pixel_phase": case.phase}
    sphere = matcam.Sphere(case.table.setup.radius)
    return answer(recorded, Rig(true_camera(case), sphere, cell_value=case.rule, **more))


def true_camera(case):
    """Camera with the true lens."""
    setup = case.table.setup
    pixel = matcam.BoxPixel(setup.half_width)
    if setup.lens:
        f = np.linspace(0, 4.2, 127)
        mtf = mean_mtf(setup, f)
        mtf[-1] = 0.0
        return matcam.Camera(matcam.MeasuredOptics(f, mtf), pixel)
    exact = Uncertainty.of({"optics.sigma_px": 0.0})
    return matcam.Camera(matcam.GaussianOptics(setup.sigma), pixel, uncertainty=exact)


def answer(recorded, rig):
    """Answer of `matcam.correct` for a recorded table, 1/sr."""
    table: xr.Dataset = matcam.correct(brdf_table(recorded, "centre"), rig)
    return Answer(*(table[name].values for name in ("brdf", "brdf_std", "supported")))


PACKAGE = {"matcam": defaults, "matcam, true lens": true_lens}
