"""Random calls of all public functions and classes with arguments of wrong types, shapes, units and labels.

    python -m tests.wrong_calls 10000 [SEED]

Allowed are a result, an error of the family and TypeError. Each other exception is a fault; then the exit status is 1.
"""

import collections
import contextlib
import decimal
import importlib
import inspect
import io
import os
import signal
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np
import xarray as xr

import matcam
from matcam.core.errors import MatcamError
from matcam.core.grid import brdf_table

SECONDS = 5
_MODULES = ["", ".io", ".batch", ".camera", ".calibration", ".exchange", ".forward", ".inverse", ".material", ".reconstruction",
            ".targets"]  # fmt: skip


class TooLongError(BaseException):
    """A call that computes: its arguments were accepted."""


def public():
    """Every public function and class by its name."""
    found = {}
    for suffix in _MODULES:
        module = importlib.import_module(f"matcam{suffix}")
        for name in module.__all__:
            thing = getattr(module, name)
            if callable(thing) and not (inspect.isclass(thing) and issubclass(thing, BaseException | tuple)):
                found[f"matcam{suffix}.{name}"] = thing
    return found


def values(folder):
    """Values of every kind, and valid ones by the name of the parameter."""
    rig, lobe = matcam.rigs.merl(), matcam.GGX(0.1)
    material = matcam.Microfacet(lobe, 0.9)
    table = brdf_table(np.full((90, 90, 180, 3), 0.5), "centre")
    samples = xr.DataArray(np.ones((2, 3)), dims=("sample", "channel"), coords={"channel": ["B", "G", "R"]})
    valid = {
        "rig": rig, "ndf": lobe, "material": material, "camera": rig.camera, "sample": rig.sample, "lamp": rig.lamp,
        "path": folder / "a.nc", "picture": np.ones((8, 8)), "name": "Cr", "wavelength": 5e-7, "alpha": 0.1, "theta_d": 0.3,
        "theta_h": 0.1, "sampling": "centre", "brdf": table, "table": table, "samples": samples, "optics": rig.camera.optics,
        "pixel": rig.camera.pixel, "sigma": 0.5, "data": xr.Dataset({"a": ("x", [1.0])}), "folder": folder,
    }  # fmt: skip
    masked = np.ma.masked_array([1.0, 2.0], [True, False])
    anything = [
        None, True, -1, 0, 1, 2, 0.5, -0.5, float("nan"), float("inf"), 1e300, 10**400, 1j, "", "x", b"x", [], [1],
        [[1], [1, 2]], (), (1, 2), {}, {"a": 1}, {1}, object(), len, int, slice(3), iter([1]), decimal.Decimal("0.5"),
        np.int8(3), np.zeros(0), np.ones(3), np.ones((2, 3)), np.ones((2, 3, 3)), np.array("x"), np.array([None]),
        np.array([1j]), masked, np.array(["2020-01-01"], "M8[D]"), np.bool_(True), xr.DataArray(np.ones(3), dims="x"),
        xr.Dataset(), samples, table, table.isel(channel=[2, 1, 0]), table.assign_attrs(units="W"),
        table.assign_coords(channel=["a", "b", "c"]),
        table.isel(theta_h=[1, 0]), table.isel(channel=0), folder, folder / "none.nc", str(folder / "none.csv"), "x" * 300,
        "a\nb", "a\0b", rig, lobe, material, rig.camera, rig.sample, rig.lamp, matcam.GGX, lambda *a: a,
    ]  # fmt: skip
    return valid, anything


def arguments(call, random, valid, anything):
    """Random arguments of a call by name: one or two wrong ones among valid ones, as far as these are known."""
    try:
        parameters = list(inspect.signature(call).parameters.values())
    except (ValueError, TypeError):
        return None
    parameters = [p for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
    if not parameters:
        return None
    wrong = set(
        random.choice(len(parameters), min(len(parameters), int(random.integers(1, 3))), replace=False).tolist()
    )
    given = {}
    for k, parameter in enumerate(parameters):
        if k in wrong or (parameter.default is parameter.empty and parameter.name not in valid):
            given[parameter.name] = anything[int(random.integers(len(anything)))]
        elif parameter.default is parameter.empty:
            given[parameter.name] = valid[parameter.name]
    return given


def outcome(call, given):
    """What becomes of a call: "result", the name of its error, and a line about a fault."""

    def end(number, frame):
        raise TooLongError

    signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, SECONDS, 1)  # again: a callback of the garbage collector swallows an error
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            call(**given)
    except MatcamError as error:
        return "error of the family", "" if str(error) and "\n" not in str(error) else f"message {str(error)[:60]!r}"
    except TypeError:
        return "TypeError", ""
    except TooLongError:
        return "computes", ""
    except Exception as error:
        place = "?"
        trace = error.__traceback__
        while trace is not None:
            if "matcam" in trace.tb_frame.f_code.co_filename and "tests" not in trace.tb_frame.f_code.co_filename:
                place = f"{Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}"
            trace = trace.tb_next
        return "fault", f"{place} {type(error).__name__}: {' '.join(str(error).split())[:80]}"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    return "result", ""


def campaign(count, seed):
    """Make so many calls: the tally of outcomes, and the faults as lines."""
    random = np.random.default_rng(seed)
    tally, faults, before = collections.Counter(), [], Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        valid, anything = values(Path(folder))
        calls = [
            (name, call) for name, call in public().items() if arguments(call, random, valid, anything) is not None
        ]
        os.chdir(folder)
        try:
            for k in range(count):
                name, call = calls[k % len(calls)]
                given = arguments(call, random, valid, anything)
                ended, why = outcome(call, given)
                tally[ended] += 1
                if why:
                    shown = ", ".join(f"{key}={' '.join(repr(value).split())[:40]}" for key, value in given.items())
                    faults.append(f"{name}({shown}): {why}")
        finally:
            os.chdir(before)
    return tally, faults


def main(arguments_):
    tally, faults = campaign(int(arguments_[0]), int(arguments_[1]) if len(arguments_) > 1 else 0)
    print(dict(tally))
    for line in faults:
        print(line)
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
