"""Suggestion of the next command, from the arguments and the outputs of the last command."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from matcam.core.io import where_written
from matcam.core.readers.names import is_folder, is_there
from matcam.files.formats import MEASUREMENTS, suffixes_for


def after(name: str, values: dict[str, Any]) -> str | None:
    """Suggest the next command. The result is None if there is no suggestion.

    Args:
        name: words of the last command, such as "data merl".
        values: parameters of the last command, and facts about its result.
    """
    maker = _NEXT.get(name)
    words = maker(values) if maker else None
    if words is None or not all(is_there(where_written(word)) for word in words if isinstance(word, Path)):
        return None
    return shlex.join(map(str, words))


def _unused(output: Path) -> str:
    """Choose an unused name for an output, because replacing a file would require --force."""
    path, number = output, 1
    while is_there(where_written(path)):
        number += 1
        path = output.with_stem(f"{output.stem}-{number}")
    return str(path)


def _camera(values: dict[str, Any]) -> list[Any]:
    found: list[Any] = ["--sample", values["sample"]] if values.get("sample", "sphere") != "sphere" else []
    for parameter in ("camera", "radius", "distance", "lamp", "lamp_distance", "sample_mm", "azimuth"):
        option, value = f"--{parameter.replace('_', '-')}", values.get(parameter)
        if value is not None and (value or parameter not in ("azimuth", "lamp")):  # defaults of 0
            found += [option, f"{value:.12g}" if isinstance(value, float) else value]
    return found


def _cells(values: dict[str, Any]) -> list[Any]:
    """List the options that state how the cells of a table were read."""
    found: list[Any] = ["--sampling", "edge"] if values.get("sampling") == "edge" else []
    found += ["--cell", values["cell"]] if values.get("cell") else []
    return found + (["--phase", *(f"{one:.12g}" for one in values["phase"])] if values.get("phase") else [])


def _of_table(values: dict[str, Any], file: Path | None) -> list[Any] | None:
    return None if file is None or values.get("blind") else _correct(file, values)


def _correct(file: Path, values: dict[str, Any]) -> list[Any]:
    words = ["matcam", "correct", file, *_camera(values), *_cells(values)]
    usual = f"{file.stem}-corrected.binary"
    if values.get("channels", 3) != 3:  # a MERL file has three channels
        return [*words, "-o", _unused(Path(usual).with_suffix(".nc"))]
    output = _unused(Path(usual))
    return words if output == usual else [*words, "-o", output]


def _after_predict(values: dict[str, Any]) -> list[Any] | None:
    if values.get("sample") == "flat" or values.get("ndf", "ggx") != "ggx":  # `limits` is for GGX lobes
        return None
    if values.get("camera"):
        from matcam.camera.camera import Camera
        from matcam.camera.optics.gaussian import GaussianOptics

        if not isinstance(Camera.load(values["camera"]).optics, GaussianOptics):
            return None
    # the smallest roughness that `limits` accepts for every rig
    wide = [value for value in values["roughness"] or [] if value >= 2.5e-4]
    return ["matcam", "limits", *wide[:5], *_camera(values)]


def _after_edge(values: dict[str, Any]) -> list[Any] | None:
    """Suggest a calibration with the options of `edge` if the images may contain enough edges, and otherwise a chart.

    If regions were measured, each photograph may contain more edges than its regions. The result is None for a
    through-focus series, because its photographs do not have the same blur.
    """
    if values.get("focus"):
        return None
    if not (values.get("roi") or values.get("rois")):
        from matcam.calibration.camera.consensus import FEWEST_EDGES

        if len(values["pictures"]) < FEWEST_EDGES:
            return ["matcam", "chart", "squares", "star", "-o", _unused(Path("chart.pdf"))]
    usual = {"cfa": None, "tone": "auto", "half_width": 0.5, "pitch": None}
    changed = [name for name, default in usual.items() if values.get(name, default) != default]
    options = [word for name in changed for word in (f"--{name.replace('_', '-')}", values[name])]
    options += ["--accept-sharpened"] if values.get("accept_sharpened") else []
    return ["matcam", "calibrate", *values["pictures"], *options, "-o", _unused(Path("camera.json"))]


def _after_simulate(values: dict[str, Any]) -> list[Any] | None:
    output = values["output"]
    if output is None:
        return ["matcam", "capture", "check", values["capture"]] if values.get("capture") else None
    if output.suffix.lower() == ".binary" and values.get("sample") != "flat":
        return ["matcam", "fresnel", output, *_camera(values)]
    return ["matcam", "inspect", output]


def _after_inspect(values: dict[str, Any]) -> list[Any] | None:
    file, report = values["file"], values["report"]
    if report["format"] == "camera profile":
        return ["matcam", "predict", "--camera", file]
    if "lamp_positions" in report:
        return ["matcam", "capture", "check", file]
    if report.get("tables"):
        return ["matcam", "correct", file, "-o", _unused(Path(f"{file.resolve().name}-corrected"))]
    if "correction" not in report or "variables" in report or "own_grid" in report:  # not a recorded or corrected table
        return None
    if report["corrected"]:
        stem = file.stem.removesuffix(".zarr")
        return ["matcam", "convert", file, _unused(file.with_name(f"{stem}.bsdf"))]
    cells = report["cells"]
    if not report["correction"]["possible"] or (cells["rule"] is not None and cells["phase_px"] is None):
        return None  # the true radius of the sphere is not known
    return _correct(file, values | {"channels": len(report["channels"]), "sample": report["sample"]})


def _after_convert(values: dict[str, Any]) -> list[Any] | None:
    target = values["target"]
    if values.get("content") == "result" and target.suffix.lower() == ".csv":
        return None
    return ["matcam", "inspect", target] if target.name.lower().endswith(suffixes_for(*MEASUREMENTS)) else None


def _after_correct(values: dict[str, Any]) -> list[Any] | None:
    paths, output = values["paths"], values["output"]
    if len(paths) != 1 or is_folder(paths[0]) or (output and output.suffix.lower() != ".binary"):
        return None
    if values.get("withheld"):  # both tables are equal
        return None
    if find_spec("mitsuba") is None:  # Mitsuba is an optional dependency
        return None
    target = output or Path(f"{paths[0].stem}-corrected.binary")
    return ["matcam", "render", paths[0], target, "-o", _unused(target.with_suffix(".png"))]


def _after_reconstruct(values: dict[str, Any]) -> list[Any] | None:
    target = values["output"] or Path(f"{values['capture'].resolve().name}-reconstructed.binary")
    return ["matcam", "inspect", target if is_there(where_written(target)) else target.with_suffix(".nc")]


def _after_data(values: dict[str, Any]) -> list[Any] | None:
    if not values["materials"]:
        return None
    return ["matcam", "inspect", values["output"] / f"{values['materials'][0]}.binary"]


def _after_check(values: dict[str, Any]) -> list[Any]:
    name = values["folder"].resolve().name or "capture"
    return ["matcam", "reconstruct", values["folder"], "-o", _unused(Path(f"{name}.binary"))]


_NEXT: dict[str, Callable[[dict[str, Any]], list[Any] | None]] = {
    "predict": _after_predict,
    "simulate": _after_simulate,
    "capture init": lambda v: ["matcam", "capture", "check", v["folder"]] if v.get("photographs") else None,
    "capture check": _after_check,
    "edge": _after_edge,
    "calibrate": lambda v: ["matcam", "inspect", v["output"]] if v["output"] else None,
    "sensor": lambda v: ["matcam", "inspect", v["profile"]] if v.get("profile") else None,
    "inspect": _after_inspect,
    "convert": _after_convert,
    "correct": _after_correct,
    "reconstruct": _after_reconstruct,
    "fit": lambda v: _of_table(v, v["files"][0]),
    "fresnel": lambda v: _of_table(v, v["file"]),
    "data merl": _after_data,
    "demo": lambda v: ["matcam", "correct", v["output"] / "simulated-chromium.binary"],
}
