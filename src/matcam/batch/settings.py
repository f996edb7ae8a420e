"""What all materials of a run have in common, and the key that their records carry."""

from __future__ import annotations

import hashlib
import json
from importlib import metadata
from pathlib import Path
from typing import Any

from matcam.batch.corrector import Corrector, Options
from matcam.errors import OutputError
from matcam.json_file import plain, read_json, write_json
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
