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
    lens, radius = facts["lens"], facts["sphere"]["radius_px"]
    if lens is None:
        camera = merl().camera
    elif lens["kind"] == "mtf":
        optics = matcam.MeasuredOptics(lens["frequency_cycles_per_px"], lens["mtf"])
        camera = matcam.Camera(optics, matcam.BoxPixel(facts["pixel_half_width_px"]))
    else:
        known = Uncertainty.of({"optics.sigma_px": lens["sigma_px"] * lens["relative_standard_deviation"]})
        pixel = matcam.BoxPixel(facts["pixel_half_width_px"])
        camera = matcam.Camera(matcam.GaussianOptics(lens["sigma_px"]), pixel, uncertainty=known)
    rule = facts["cell_value"]
    return answer(recorded, Rig(camera, matcam.Sphere(radius), cell_value="unknown" if lens is None else rule))


def true_lens(recorded, case, facts):
    """Answer of `matcam.correct` with the true lens; of a lens without rotational symmetry its MTF, mean over azimuths."""
    setup = case.table.setup
    if setup.lens:
        f = np.linspace(0, 4.2, 127)
        mtf = mean_mtf(setup, f)
        mtf[-1] = 0.0
        camera = matcam.Camera(matcam.MeasuredOptics(f, mtf), matcam.BoxPixel(setup.half_width))
    else:
        exact = Uncertainty.of({"optics.sigma_px": 0.0})
        optics = matcam.GaussianOptics(setup.sigma)
        camera = matcam.Camera(optics, matcam.BoxPixel(setup.half_width), uncertainty=exact)
    more = {} if case.rule == "centre" else {"pixel_phase": case.phase}
    return answer(recorded, Rig(camera, matcam.Sphere(setup.radius), cell_value=case.rule, **more))


def answer(recorded, rig):
    """Answer of `matcam.correct` for a recorded table, 1/sr."""
    table: xr.Dataset = matcam.correct(brdf_table(recorded, "centre"), rig)
    return Answer(*(table[name].values for name in ("brdf", "brdf_std", "supported")))


PACKAGE = {"matcam": defaults, "matcam, true lens": true_lens}
