"""Folder of a run: lock, settings, assignment of outputs to inputs, and files that describe the entire run."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import filelock

from matcam.batch.job import Job, Outcome, failed
from matcam.batch.recipe import SETTINGS_FORMAT
from matcam.batch.store import open_rows, whole_rows
from matcam.core.errors import ArgumentError, FileFormatError, OutputError
from matcam.core.io import check_output, reading, write_json
from matcam.core.readers.names import check_name, check_within, is_folder, is_there
from matcam.core.readers.texts import read_json
from matcam.files.datasets import read_netcdf

SETTINGS = "settings.json"
_INDEX, _FAILED, _CAMERA, _ZARR = "index.html", "failed.json", "camera.json", "run.zarr"
_RESERVED = {Path(name).stem for name in (_INDEX, _FAILED, _CAMERA, SETTINGS)}


class RunFolder:
    """Folder of a run.

    Args:
        path: the folder.
    """

    def __init__(self, path: Path):
        self.path = path
        self.index, self.camera, self.zarr = path / _INDEX, path / _CAMERA, path / _ZARR
        self._settings, self._failed = path / SETTINGS, path / _FAILED

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Create the folder if needed and lock it against other runs.

        The system releases the lock when this process dies. A file system without locks is used without a lock. An
        OutputError is raised if another run has locked the folder, if the folder contains a symbolic link, or if it cannot
        be created.
        """
        lock = filelock.FileLock(self.path / ".lock")
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            self._check_links()
            lock.acquire(timeout=0)
        except filelock.Timeout:
            raise OutputError(
                f"output folder {self.path} is in use by another run: wait until it has ended, or choose another folder"
            ) from None
        except NotImplementedError:
            pass  # the error of filelock for a file system without locks
        except OSError as error:
            # some network file systems have no locks
            if error.errno not in (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP):
                raise OutputError(
                    f"output folder {self.path} cannot be written: {error.strerror}; choose another folder"
                ) from None
        try:
            yield
        finally:
            lock.release()

    def _check_links(self) -> None:
        """Raise OutputError if the folder contains a symbolic link, because all files of a run must be in its folder."""
        for folder, folders, files in os.walk(self.path):
            for name in (*folders, *files):
                if (path := Path(folder, name)).is_symlink():
                    raise OutputError(f"output {path} is a symbolic link in a run's folder: remove it")
            if folder == str(self.path):  # the only subfolder that a run creates
                folders[:] = [name for name in folders if name == _ZARR]

    def outputs(self, paths: Iterable[str | Path]) -> tuple[dict[Path, Path], list[Outcome]]:
        """Find the tables in `paths`, and the output file of each table in this folder.

        A folder in `paths` stands for the *.binary files that it contains, in the order of their names. Duplicates are
        omitted.

        Returns:
            The output of each input, and the outcomes of rejected inputs. An input is rejected if it is a link to a file
            outside its folder, or if its name is not plain text. It is also rejected if another input or a file of the run
            has the same name.

        Raises:
            ArgumentError: there is no table.
            OutputError: an input is in this folder, under the name of its output.
        """
        given = [Path(path) for path in paths]
        found: dict[Path, Path] = {}
        refused = []
        for path in given:
            inside = [path]
            if is_folder(path):
                with reading(path):
                    inside = sorted(p for p in path.iterdir() if p.suffix.lower() == ".binary" and p.name[0] != ".")
            for file in inside:
                try:
                    check_name(file)
                    if file != path:
                        check_within(file, path)
                except FileFormatError as error:
                    refused.append(Outcome(file, 0.0, str(error)))
                    continue
                found.setdefault(file.resolve(), file)
        if not found and not refused:
            raise ArgumentError(
                f"{', '.join(map(str, given)) or 'no path'}: there is no *.binary file: give MERL files, or folders with such "
                "files"
            )
        namesakes: dict[str, list[Path]] = {}
        for file in found.values():
            # some file systems are not case sensitive
            namesakes.setdefault(file.stem.casefold(), []).append(file)
        outputs: dict[Path, Path] = {}
        for stem, files in namesakes.items():
            for file in files:
                output = self.path / f"{file.stem}.binary"
                if is_there(output) and is_there(file) and output.samefile(file):
                    raise OutputError(f"output {output} is the input itself: choose another folder")
                if len(files) > 1:
                    others = ", ".join(str(other) for other in files if other is not file)
                    refused.append(failed(file, f"has the same name as {others}: rename one of these files"))
                elif stem in _RESERVED:
                    refused.append(failed(file, f"{file.stem} is the name of a file of the run: rename this input"))
                else:
                    outputs[file] = output
        return outputs, refused

    def check(self, settings: dict[str, Any], jobs: Sequence[Job], *, force: bool) -> bool:
        """Check whether the folder already belongs to a run with these settings.

        Unless `force` is True, an OutputError is raised if the folder belongs to a run with other settings. The message
        contains the first setting that differs. Unless `force` is True, an OutputError is also raised if the folder
        belongs to no run, but contains files with the names of the outputs. An OutputError is always raised if the
        settings file in the folder is not that of a run.
        """
        if not is_there(self._settings):
            for path in (*(path for job in jobs for path in job.files), self.index, self._failed, self.camera):
                check_output(path, force=force)
            return False
        there = read_json(self._settings, "the settings of a run")
        if not isinstance(there, dict) or there.get("format") != SETTINGS_FORMAT:
            raise OutputError(f"output {self._settings} does not contain the settings of a run: choose another folder")
        different = _first_difference(there, settings)
        if different is not None and not force:
            name, old, new = different
            raise OutputError(
                f"output folder {self.path} belongs to another run, whose {name} is {old} instead of {new}: choose another "
                "folder, or use force=True to correct everything again"
            )
        return different is None

    def claim(self, settings: dict[str, Any]) -> None:
        write_json(self._settings, settings, force=True)

    def sweep(self, jobs: Iterable[Job]) -> None:
        """Remove temporary files that a killed process left beside the files of the run."""
        stems = {*_RESERVED, *(job.name for job in jobs)}
        for path in self.path.iterdir():
            found = re.fullmatch(r"\.(.+)-[a-z0-9_]{8}\.(?:binary|nc|json|html|png)(?:\.old)?", path.name)
            if found and found[1] in stems:
                path.unlink(missing_ok=True)

    def assign_rows(self, jobs: Sequence[Job], waiting: Sequence[Job]) -> list[Job]:
        """Assign a row in the Zarr store of the run to each waiting job.

        A finished material has no complete row if the store was requested later, or was lost. The row is then copied from
        the NetCDF file of the material. The exceptions are those of `open_rows` and `StoreRow.write`.
        """
        if not jobs:
            return list(waiting)
        recipe = jobs[0].recipe
        rows = open_rows(self.zarr, [job.name for job in jobs], recipe.sampling)
        whole = whole_rows(self.zarr)
        later = {job.name for job in waiting}
        for job in jobs:
            if job.name not in later and not whole[rows[job.name].row]:
                rows[job.name].write(read_netcdf(job.output.with_suffix(".nc")))
        return [replace(job, row=rows[job.name]) for job in waiting]

    def write_failures(self, failures: Sequence[Outcome]) -> None:
        if not failures:
            self._failed.unlink(missing_ok=True)
            return
        listed = [{"file": str(f.source), "reason": f.reason, "trace": f.trace} for f in failures]
        write_json(self._failed, {"failed": listed}, force=True)


def _first_difference(old: Any, new: Any, name: str = "") -> tuple[str, str, str] | None:
    if isinstance(old, dict) and isinstance(new, dict):
        for key in [*new, *(key for key in old if key not in new)]:
            found = _first_difference(old.get(key), new.get(key), f"{name}.{key}" if name else str(key))
            if found:
                return found
        return None
    return None if old == new else (name, _short(old), _short(new))


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."
