"""What all materials of a run have in common, and the key that their records carry.

Which tables a run is to correct: files and folders, each table under a name of its own.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from matcam.batch.job import Corrector, Options, Outcome
from matcam.core.errors import ArgumentError, OutputError
from matcam.core.io import reading
from matcam.core.json import plain, read_json, write_json
from matcam.rigs import Rig

SETTINGS = "settings.json"
_FORMAT = "matcam run"


def settings_of(
    rig: Rig, options: Options, *, sampling: str, pages: bool, fit_camera: bool, corrector: Corrector
) -> dict[str, Any]:
    """Everything that decides what a run's files hold, as plain numbers and texts."""
    return plain(
        {
            "format": _FORMAT,
            "matcam": metadata.version("matcam"),
            "corrector": f"{corrector.__module__}:{corrector.__qualname__}",
            "rig": numbers_of(rig),
            "ndf": options.ndf,
            "masking": options.masking or "none",
            "glare": options.glare,
            "sampling": sampling,
            "pages": pages,
            "fit_camera": fit_camera,
        }
    )


def numbers_of(rig: Rig) -> dict[str, Any]:
    """All that a rig's results depend on."""
    described = rig.description()
    described["camera"].pop("provenance")  # holds today's date, and changes no number
    return {**described, "crop": rig.crop, "cell_value": rig.cell_value}


def key_of(settings: dict[str, Any]) -> str:
    """A name made of the settings' content."""
    return hashlib.sha256(json.dumps(plain(settings), sort_keys=True).encode()).hexdigest()[:32]


def belongs(folder: Path, settings: dict[str, Any], *, force: bool = False) -> bool:
    """Whether `folder` already is this run's. OutputError, naming the setting, where it is another run's, unless `force`."""
    path = folder / SETTINGS
    if not path.exists():
        return False
    there = read_json(path, "the settings of a run")
    if not isinstance(there, dict) or there.get("format") != _FORMAT:
        raise OutputError(f"output {path} is not the settings of a run: choose another folder")
    different = _difference(there, settings)
    if different is not None and not force:
        name, old, new = different
        raise OutputError(
            f"output folder {folder} is another run's: its {name} is {old}, this run's is {new}; choose another folder, or use "
            "--force (force=True) to do everything again"
        )
    return different is None


def claim(folder: Path, settings: dict[str, Any]) -> None:
    """Make a folder this run's."""
    write_json(folder / SETTINGS, settings, force=True)


def _difference(old: Any, new: Any, name: str = "") -> tuple[str, str, str] | None:
    """(name, old, new) of the first entry that is not the same."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in [*new, *(key for key in old if key not in new)]:
            found = _difference(old.get(key), new.get(key), f"{name}.{key}" if name else str(key))
            if found:
                return found
        return None
    return None if old == new else (name, _short(old), _short(new))


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."


INDEX, FAILED, CAMERA = "index.html", "failed.json", "camera.json"
_TAKEN = {Path(name).stem for name in (INDEX, FAILED, CAMERA, SETTINGS)}


def inputs_of(paths: Iterable[str | Path]) -> list[Path]:
    """The tables that `paths` name, in order and each once: files as they are, of a folder its *.binary by name.
    ArgumentError where that is none at all."""
    found: dict[Path, Path] = {}
    given = [Path(path) for path in paths]
    for path in given:
        for file in _tables_in(path) if path.is_dir() else [path]:
            found.setdefault(file.resolve(), file)
    if not found:
        raise ArgumentError(f"{', '.join(map(str, given)) or 'no path'}: no *.binary in there")
    return list(found.values())


def _tables_in(folder: Path) -> list[Path]:
    with reading(folder):
        return sorted(p for p in folder.iterdir() if p.suffix.lower() == ".binary" and not p.name.startswith("."))


def named(inputs: Sequence[Path], folder: Path) -> tuple[dict[str, Path], list[Outcome]]:
    """Inputs by their materials' names, and those that have none of their own: two inputs with one name would write the same
    files, and a run's own files have names too. OutputError where the folder holds an input."""
    by_name: dict[str, list[Path]] = {}
    for path in inputs:
        # some file systems do not tell upper from lower case
        by_name.setdefault(path.stem.casefold(), []).append(path)
    good: dict[str, Path] = {}
    refused = []
    for alike in by_name.values():
        for path in alike:
            output = folder / f"{path.stem}.binary"
            if output.exists() and path.exists() and output.samefile(path):
                raise OutputError(f"output {output} is the input itself: choose another folder")
            if len(alike) > 1:
                others = ", ".join(str(other) for other in alike if other is not path)
                refused.append(Outcome(path, 0.0, f"{path}: its name is also that of {others}: rename one"))
            elif path.stem.casefold() in _TAKEN:
                refused.append(Outcome(path, 0.0, f"{path}: {path.stem} is the name of a file of the run: rename it"))
            else:
                good[path.stem] = path
    return good, refused
