"""Overviews of photographs, of folders and of the JSON files of results, as plain values."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from matcam.core.errors import FileFormatError
from matcam.core.io import reading
from matcam.core.readers.apart import read_apart
from matcam.core.readers.names import is_file
from matcam.core.readers.texts import SMALL_TEXT, read_json
from matcam.files.capture import KINDS, SETTINGS, read_capture
from matcam.files.float_pictures import read_exr_layers
from matcam.files.photographs import PICTURES, SUFFIXES, open_photograph
from matcam.files.picture_header import read_exif
from matcam.files.table_decoders import is_samples

_RUN_SETTINGS, _RUN_FAILURES = "settings.json", "failed.json"
"""Files in the folder of a run of `matcam correct` (`batch/folder.py`)."""


def is_photograph(path: Path) -> bool:
    """Check whether a file is a photograph: an image of integers (PNG, JPEG or TIFF) or a camera raw file."""
    if not is_file(path):
        return False
    with path.open("rb") as file:
        coded = file.read(4).startswith((b"\x89PNG", b"\xff\xd8\xff"))  # PNG and JPEG, whose values are integers
    exif = read_exif(path)
    return coded or exif.dng or path.suffix.lower() in SUFFIXES or exif.integers


def photograph_overview(path: Path) -> dict[str, Any]:
    photograph = open_photograph(path)
    values, exif = photograph.values, photograph.exif
    colour = values.ndim == 3
    saturation = photograph.saturation if np.isfinite(photograph.saturation) else None
    return {
        "format": path.suffix.lower().lstrip(".") or "image",
        "holds": "a photograph",
        "size_px": [values.shape[1], values.shape[0]],
        "channels": ["R", "G", "B"] if colour else [photograph.cfa or "grey"],
        "bits": 8 * values.dtype.itemsize,
        "range": [float(values.min()), float(values.max())],
        "saturation": saturation,
        "saturated_share": None if saturation is None else float((values >= saturation).mean()),
        "linear": photograph.linear,
        "camera": exif.camera,
        "f_number": exif.f_number,
        "exposure_time_s": exif.time,
    }


def result_overview(path: Path) -> dict[str, Any] | None:
    """Report on the JSON file of a correction, a reconstruction, a fit or uncertainty budgets.

    The result is None for any other JSON file.
    """
    document = read_json(path, "a result")
    if not isinstance(document, dict):
        return None
    if not (isinstance(document.get("verdict"), str) or "budgets" in document or {"params", "ndf"} <= set(document)):
        return None
    fit = document.get("fit")
    known = {**fit, **document} if isinstance(fit, dict) else document
    try:
        if "budgets" in known:
            budgets = {
                one["result"]: f"{one['value']:.6g} ± {one['combined_standard_uncertainty']:.2g}"
                for one in known["budgets"]
            }
            return {"format": "result (JSON)", "holds": "uncertainty budgets", "value ± standard uncertainty": budgets}
        about: dict[str, Any]
        if "verdict" not in known:
            about = {"holds": f"the result of a fit to {', '.join(known['files'])}", "family": known["ndf"]}
            pairs = {name: [value, known["std"][name]] for name, value in known["params"].items()}
        elif "params" in known:  # a correction
            about = {"holds": "the result of a correction", "table": known["file"], "family": known["ndf"]}
            about["lens"] = _in_words(known["camera"]["optics"])
            pairs = {name: [value, known["std"][name]] for name, value in known["params"].items()}
        else:
            about = {
                "holds": f"the result of a reconstruction from photographs of a {known['sample']}",
                "family": known["lobe"]["family"],
                "images": len(known["pictures"]),
                "left_out": known["left_out"],
            }
            pairs = known["parameters"]
        return {
            "format": "result (JSON)",
            **about,
            "verdict": known.get("verdict"),
            "supported_share": known.get("supported_share"),
            "parameters": {name: {"value": value, "std": std} for name, (value, std) in pairs.items()},
            "remarks": [remark["text"] for remark in known["remarks"]],
        }
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise FileFormatError(
            f"{path}: damaged result, in which a field is missing or wrong ({error}): create the file again"
        ) from None


def layers_overview(path: Path) -> dict[str, Any] | None:
    """Report on an OpenEXR file with layers. The result is None for an image without layers."""
    layers = read_exr_layers(path)
    if list(layers) == [""]:
        return None
    return {
        "format": "exr",
        "holds": "an image with layers",
        "layers": {n: _in_numbers(one) for n, one in layers.items()},
    }


def _in_numbers(picture: np.ndarray) -> str:
    height, width, *channels = picture.shape
    known = picture[np.isfinite(picture)]
    values = f"values {known.min():.6g} to {known.max():.6g}" if known.size else "all values are missing"
    return f"{width} x {height} px, {(*channels, 1)[0]} channels, {values}"


def columns_overview(path: Path) -> dict[str, Any] | None:
    """Report on a CSV file of a result. The result is None for samples of a BRDF."""
    with reading(path), path.open("rb") as file:
        if is_samples(file.readline(4096).decode("utf-8", "replace")):
            return None
    decoder = "matcam.files.table_decoders:decode_columns"
    found = read_apart(decoder, path, "a CSV file", libraries=("pandas",), small=SMALL_TEXT)
    columns = {name: " to ".join(f"{end:.6g}" for end in ends) or "-" for name, ends in found["ranges"].items()}
    return {"format": "csv", "holds": "columns of a result", "rows": found["rows"], "columns": columns}


def folder_overview(folder: Path) -> dict[str, Any]:
    if is_file(folder / SETTINGS):
        return _capture_overview(folder)
    if is_file(folder / _RUN_SETTINGS):
        settings = read_json(folder / _RUN_SETTINGS, "the settings of a run")
        if isinstance(settings, dict) and settings.get("format") == "matcam run":
            return _run_overview(folder, settings)
    suffixes = Counter(path.suffix.lower() for path in folder.iterdir() if is_file(path))
    results = sum(is_file(path.with_suffix(".nc")) for path in folder.iterdir() if path.suffix.lower() == ".binary")
    tables, photographs = suffixes[".binary"], sum(suffixes[suffix] for suffix in PICTURES)
    if not tables and not photographs:
        raise FileFormatError(
            f"{folder}: the folder contains no capture ({SETTINGS}), no results of a run ({_RUN_SETTINGS}), no tables "
            "(.binary) and no photographs: give another folder, or a file"
        )
    return {
        "format": "folder",
        "holds": "a folder of files",
        "tables": tables - results,
        "results": results,
        "photographs": photographs,
    }


def _capture_overview(folder: Path) -> dict[str, Any]:
    capture = read_capture(folder)
    kinds = Counter(frame.kind for frame in capture.frames)
    return {
        "format": "folder",
        "holds": f"a capture of a {capture.settings['sample']['kind']}",
        "lamp_positions": len(capture.lamps),
        "exposures": capture.exposures,
        "images": {kind: kinds[kind] for kind in KINDS},
        "camera_profile": None if capture.profile is None else str(capture.profile),
        "problems": [str(problem) for problem in capture.problems],
    }


def _run_overview(folder: Path, settings: dict[str, Any]) -> dict[str, Any]:
    failed, pages = folder / _RUN_FAILURES, folder / "index.html"
    try:
        listed = read_json(failed, "the failures of a run")["failed"] if is_file(failed) else []
        return {
            "format": "folder",
            "holds": "the results of a run of matcam correct",
            "corrected": sorted(path.stem for path in folder.glob("*.nc") if is_file(path)),
            "failed": [str(one["reason"]) for one in listed],
            "sample": _in_words(settings["rig"]["sample"]),
            "lens": _in_words(settings["rig"]["camera"]["optics"]),
            "page": str(pages) if is_file(pages) else None,
        }
    except (KeyError, TypeError, AttributeError) as error:
        raise FileFormatError(
            f"{folder}: {_RUN_SETTINGS} or {_RUN_FAILURES} is damaged, because a field is missing or wrong ({error}): repeat "
            "the run"
        ) from None


def _in_words(description: dict[str, Any]) -> str:
    single = {name: value for name, value in description.items() if isinstance(value, str | float | int)}
    return ", ".join(str(value) if isinstance(value, str) else f"{name} {value:g}" for name, value in single.items())
