"""The command that is useful next, by what the last one was asked for and wrote."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any


def after(name: str, values: dict[str, Any]) -> str | None:
    """Return the next useful command, or None.

    Args:
        name: the command's words, such as "data merl".
        values: its parameters.
    """
    maker = _NEXT.get(name)
    words = maker(values) if maker else None
    return None if words is None else shlex.join(map(str, words))


def _camera(values: dict[str, Any]) -> list[Any]:
    """Return the options of the same rig."""
    found: list[Any] = ["--sample", values["sample"]] if values.get("sample", "sphere") != "sphere" else []
    for parameter in ("camera", "radius", "distance", "lamp_distance", "sample_mm"):
        option = f"--{parameter.replace('_', '-')}"
        if values.get(parameter) is not None:
            found += [option, values[parameter]]
    if values.get("azimuth"):
        found += ["--azimuth", values["azimuth"]]
    return found


def _of_table(values: dict[str, Any], file: Path | None) -> list[Any] | None:
    return None if file is None else ["matcam", "correct", file, *_camera(values)]


def _after_simulate(values: dict[str, Any]) -> list[Any] | None:
    output = values["output"]
    if output is None:
        return ["matcam", "capture", "check", values["capture"]] if values.get("capture") else None
    if output.suffix.lower() == ".binary" and values.get("sample") != "flat":
        return ["matcam", "fresnel", output, *_camera(values)]
    return ["matcam", "inspect", output]


def _after_reconstruct(values: dict[str, Any]) -> list[Any] | None:
    output = values["output"]
    if output is None:
        return None
    # a flat sample, and an anisotropic material, have no MERL file
    written = [file for file in (output, output.with_suffix(".nc")) if file.exists()]
    return ["matcam", "inspect", written[0]] if written else None


def _after_inspect(values: dict[str, Any]) -> list[Any] | None:
    file = values["file"]
    if file.suffix.lower() in (".binary", ".csv"):
        return ["matcam", "correct", file]
    if file.suffix.lower() == ".json":
        return ["matcam", "predict", "--camera", file]
    return None


def _after_correct(values: dict[str, Any]) -> list[Any] | None:
    paths, output = values["paths"], values["output"]
    if len(paths) != 1 or paths[0].is_dir() or (output and output.suffix.lower() != ".binary"):
        return None
    target = output or Path(f"{paths[0].stem}-corrected.binary")
    return ["matcam", "render", paths[0], target, "-o", target.with_suffix(".png")]


def _after_data(values: dict[str, Any]) -> list[Any] | None:
    if not values["materials"]:
        return None
    return ["matcam", "inspect", values["output"] / f"{values['materials'][0]}.binary"]


def _after_check(values: dict[str, Any]) -> list[Any]:
    return ["matcam", "reconstruct", values["folder"], "-o", f"{values['folder'].name or 'capture'}.binary"]


_NEXT: dict[str, Callable[[dict[str, Any]], list[Any] | None]] = {
    "predict": lambda v: ["matcam", "limits", *(v["roughness"] or [])[:5], *_camera(v)],
    "simulate": _after_simulate,
    "capture check": _after_check,
    "chart": lambda v: [
        "matcam",
        "calibrate",
        "PHOTOGRAPHS",
        "--chart",
        v["output"].with_suffix(".json"),
        "-o",
        "camera.json",
    ],
    "edge": lambda v: ["matcam", "calibrate", v["picture"], "-o", "camera.json"],
    "calibrate": lambda v: ["matcam", "inspect", v["output"]] if v["output"] else None,
    "inspect": _after_inspect,
    "convert": lambda v: ["matcam", "inspect", v["target"]],
    "correct": _after_correct,
    "reconstruct": _after_reconstruct,
    "fit": lambda v: _of_table(v, v["files"][0]),
    "fresnel": lambda v: _of_table(v, v["file"]),
    "data merl": _after_data,
    "demo": lambda v: ["matcam", "correct", v["output"] / "simulated-chromium.binary"],
}
