"""A corrector that costs nothing, and ones that go wrong: a run's workers import them by name."""

import os
import signal
import time
from pathlib import Path

import numpy as np
import xarray as xr

from matcam.batch.executors.local import ProcessExecutor
from matcam.batch.job import attempt
from matcam.batch.recipe import CorrectedTable
from matcam.camera.optics.gaussian import GaussianOptics
from matcam.core.io import replacing

GAIN = 1.25


def work_in_this_process(monkeypatch):
    """Let a run's jobs be done here: no worker has to be started."""
    monkeypatch.setattr(ProcessExecutor, "outcomes", lambda self, jobs: (attempt(job) for job in jobs))


def brighter(table, rig, options):
    """Every entry times GAIN; notes in the environment's MATCAM_TEST_LOG that it was here."""
    if log := os.environ.get("MATCAM_TEST_LOG"):
        with Path(log).open("a") as file:
            file.write(f"{table.attrs['source']} {os.getpid()}\n")
    data = xr.Dataset(
        {
            "brdf": table * GAIN,
            "brdf_std": table * 0.01,
            "correction_std": table * 0 + 0.006,
            "noise_std": table * 0.008,
            "supported": table.notnull(),
            "response": table * 0 + 1 / GAIN,
        }
    )
    summary = {
        "ndf": "ggx", "spline_modified": False, "params": {"alpha": 0.01, "diffuse[R]": 0.1},
        "std": {"alpha": 1e-4, "diffuse[R]": float("nan")},
        "hwhm_rad": float(np.nanmean(table.values[0])), "hwhm_std_rad": 1e-4, "determined": True,
        "noise": {"relative": 0.01, "floor": 1e-4, "picture_gain": 0.01}, "misfit": 1.0, "log_likelihood": 0.0,
        "degrees_of_freedom": 10, "remarks": [],
    }  # fmt: skip
    document = {
        "camera": rig.camera.profile(), "fit": summary, "refits": {}, "glare": options.glare,
        "shape": {"scale": 0.0, "b": []}, "determination": "determined", "supported_share": 1.0, "peak_gain_75": GAIN,
        "peak_lost": {"5": 0.1, "45": None, "75": 1 - 1 / GAIN}, "verdict": "Well determined.",
        "remarks": [],
    }  # fmt: skip

    def write_page(path, name, force):
        with replacing(path, force=force) as temporary:
            temporary.write_text(f"<title>{name}</title>")

    return CorrectedTable(data, document, write_page)


def slowly(table, rig, options):
    """The same after half a second."""
    time.sleep(0.5)
    return brighter(table, rig, options)


def noted_then_slowly(table, rig, options):
    """Noted at once, done after half a second."""
    done = brighter(table, rig, options)
    time.sleep(0.5)
    return done


def deadly(table, rig, options):
    """Kills its worker over the material "poison"."""
    if table.attrs["source"] == "poison.binary":
        os.kill(os.getpid(), signal.SIGKILL)
    return brighter(table, rig, options)


def hanging(table, rig, options):
    """Does not return over the material "poison"."""
    if table.attrs["source"] == "poison.binary":
        time.sleep(3600)
    return brighter(table, rig, options)


def faulty(table, rig, options):
    """Has a bug that shows over the material "odd"."""
    if table.attrs["source"] == "odd.binary":
        raise ZeroDivisionError("a bug")
    return brighter(table, rig, options)


def records_lens(table, rig, options):
    """Says in its record with which lens it was asked to work."""
    done = brighter(table, rig, options)
    assert isinstance(rig.camera.optics, GaussianOptics)
    return done._replace(document={**done.document, "lens": float(rig.camera.optics.sigma)})
