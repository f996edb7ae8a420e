"""Random calls of all public functions and classes with arguments of wrong types, shapes, units and labels.

    python -m tests.wrong_calls 10000 [SEED] [deep]

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


def more_valid(folder):
    """Valid values by the name of the parameter, with which calls get beyond their first checks, and take longer."""
    y, x = np.mgrid[-40:40, -30:30]
    image = 100 + 800 / (1 + np.exp(-2 * (x - 0.1 * y)))
    lens, lobe = matcam.GaussianOptics(0.5), matcam.GGX(0.3)
    source = matcam.UncertaintySource("a", 1.0, 0.1, 1.0, "B")
    (folder / "a.csv").write_text("theta_h_deg,theta_d_deg,phi_d_deg,Y_per_sr\n1,30,90,0.25\n")
    result = xr.Dataset(
        {name: (("theta_d", "channel"), np.ones((8, 3))) for name in ("raw", "corrected")}
        | {"supported_angle": ("channel", [1.3] * 3)},
        {"theta_d": np.radians(np.arange(5.0, 80.0, 10.0)), "channel": ["R", "G", "B"]},
        {"normalised_over": [0.17, 0.79]},
    )
    return {
        "image": image, "images": np.stack([image, image]), "edge": matcam.edge_mtf(image), "pictures": [image],
        "chart": matcam.targets.design_chart(["star"]), "level": 0.5, "frequency": [0.1, 0.2], "mtf": [0.9, 0.8],
        "theta": 0.3, "theta_o": 0.2, "lamp_angle": 0.3, "angle": 0.1, "radius": 100.0, "size": 16, "centre": (20.0, 20.0),
        "n": 1.5, "k": 2.0, "eta": 1.5, "f0": 0.04, "f_number": 8.0, "pixel_pitch": 5e-6, "fraction": 0.1, "unit": 100.0,
        "core": lens, "red": lens, "green": lens, "blue": lens, "fresnel": matcam.material.Constant(0.9), "power": 1.0,
        "alpha_along": 0.1, "alpha_across": 0.3, "distance": 700.0, "blur_diameter": 2.0, "pitch": 5e-6, "full_well": 1e4,
        "read_noise": 2.0, "seed": 1, "radiance": image / 1000, "exposures": [0.1, 1.0],
        "sensor": matcam.Sensor(5e-6, 1e4, 2.0),
        "sources": [source], "value": 1.0, "budgets": [matcam.UncertaintyBudget("x", 1.0, [source])], "result": result,
        "fields": matcam.exchange.adaptive_grid(matcam.Microfacet(lobe, 0.9), square=8), "thing": result,
        "positions": [matcam.io.LightPosition("a.tif", np.array([0.0, 0.5, 0.5]))], "source": folder / "a.csv",
        "target": folder / "b.nc", "paths": [folder / "a.csv"], "output": folder / "out", "highlights": None,
        "capture": folder, "covariance": np.eye(2), "names": ["a", "b"], "values": np.ones((2, 2)),
        "noise": matcam.camera.PixelNoise(0.01, 0.0),
    }  # fmt: skip


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
    is_over = False

    def end(number, frame):
        if not is_over:
            raise TooLongError

    signal.signal(signal.SIGALRM, end)
    signal.setitimer(
        signal.ITIMER_REAL, SECONDS, SECONDS
    )  # again: a callback of the garbage collector swallows an error
    try:
        return _outcome(call, given)
    except TooLongError:
        is_over = True
        return "computes", ""
    finally:
        is_over = True
        signal.setitimer(signal.ITIMER_REAL, 0)


def _outcome(call, given):
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            call(**given)
    except MatcamError as error:
        return "error of the family", "" if str(error) and "\n" not in str(error) else f"message {str(error)[:60]!r}"
    except TypeError:
        return "TypeError", ""
    except Exception as error:
        position = "?"
        trace = error.__traceback__
        while trace is not None:
            if "matcam" in trace.tb_frame.f_code.co_filename and "tests" not in trace.tb_frame.f_code.co_filename:
                position = f"{Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}"
            trace = trace.tb_next
        return "fault", f"{position} {type(error).__name__}: {' '.join(str(error).split())[:80]}"
    return "result", ""


def campaign(count, seed, *, deep=False):
    """Make so many calls: the tally of outcomes, and the faults as lines. deep: more of their arguments are valid."""
    random = np.random.default_rng(seed)
    tally, faults, before = collections.Counter(), [], Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        valid, anything = values(Path(folder))
        if deep:
            valid |= more_valid(Path(folder))
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
    deep = "deep" in arguments_
    count, seed, *_ = [*(int(one) for one in arguments_ if one != "deep"), 0]
    tally, faults = campaign(count, seed, deep=deep)
    print(dict(tally))
    for line in faults:
        print(line)
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
