"""Which tables a run is to correct: files and folders, each table under a name of its own."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from matcam.batch.job import Outcome
from matcam.batch.settings import SETTINGS
from matcam.errors import ArgumentError, OutputError
from matcam.input_file import reading

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
