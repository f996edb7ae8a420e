"""Zarr store of a run: arrays over all materials of the run, which `xarray.open_zarr` reads lazily.

The extra `matcam[scale]` is required. The store is a folder in format version 3, with the dimensions (material, theta_h,
theta_d, phi_d, channel). Each material has its own chunk of each array, so workers write rows in parallel. The array
`corrected` marks complete rows, and is written last.

The content of the folder is not trusted. The arrays must have the shapes and types of a run, and chunks are decoded only in
a separate process (core/readers/apart.py). A worker writes whole chunks without decoding.
"""

from __future__ import annotations

import os
import stat
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from matcam.core import checks
from matcam.core.errors import FileFormatError, OutputError
from matcam.core.grid import CHANNELS, DIMS, GRID_SHAPE, Sampling, merl_grid
from matcam.core.readers.apart import read_apart
from matcam.core.readers.names import is_file
from matcam.core.readers.texts import read_json
from matcam.files.datasets import with_short_deviations
from matcam.files.decoders import DESCRIPTION, check_codecs, check_lengths, chunk_shape
from matcam.inverse.correction.corrected_table import TABLE_ATTRIBUTES

_ROW, _DONE = "material", "corrected"
_MOST_ROWS = 1_000_000
"""Largest number of materials in a run. Their names alone take 64 MB."""
_VALUES: dict[str, tuple[type, dict[str, str]]] = {
    name: (bool if name == "supported" else np.float32 if name.endswith("_std") else float, attributes)
    for name, attributes in TABLE_ATTRIBUTES.items()
}
"""Type and attributes of each variable. As in NetCDF, standard deviations have 7 digits."""
_NAMES_A_CHUNK = 4096
_SIZES = (*GRID_SHAPE, len(CHANNELS))


class StoreRow(NamedTuple):
    """Row of one material in the Zarr store of a run.

    Attributes:
        store: folder of the Zarr store.
        row: index of the material along the first dimension of the store.
    """

    store: Path
    row: int

    def write(self, data: xr.Dataset) -> None:
        """Write a corrected table to this row. An OutputError is raised if the row cannot be written."""
        try:
            group = _zarr().open_group(self.store, mode="r+", zarr_format=3, use_consolidated=False)
            group[_DONE][self.row] = False
            for name, one in with_short_deviations(data[list(_VALUES)]).items():
                group[str(name)][self.row] = one.values
            group[_DONE][self.row] = True
        except (OSError, KeyError) as error:
            reason = getattr(error, "strerror", None) or error
            raise OutputError(
                f"output {self.store}, row {self.row}, cannot be written: {reason}; check the folder and its free space"
            ) from None


def open_rows(store: Path, names: Sequence[str], sampling: Sampling) -> dict[str, StoreRow]:
    """Assign a row of a store to each material. The store is created or extended as needed.

    An ArgumentError is raised if zarr is not installed. An OutputError is raised if the folder is not the Zarr store of a
    run, or cannot be written.
    """
    zarr = _zarr()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter(
                "ignore"
            )  # text has no final specification in Zarr 3: other readers may not support it
            _check_arrays(store)
            group = zarr.open_group(store, mode="a", zarr_format=3, use_consolidated=False)
            if _ROW not in group:
                if any(True for _ in group):
                    raise OutputError(f"output {store} is not the Zarr store of a run: choose another folder")
                _create_arrays(group, sampling)
            there = _stored(store, [_ROW])[_ROW].tolist()
            new = [name for name in names if name not in set(there)]
            if new:
                _grow(group, [*there, *new])
    except (FileFormatError, OSError, KeyError, ValueError) as error:
        raise OutputError(
            f"output {store} cannot be written as the Zarr store of a run: {error}; choose another folder"
        ) from None
    return {name: StoreRow(store, row) for row, name in enumerate([*there, *new])}


def whole_rows(store: Path) -> np.ndarray:
    return _stored(store, [_DONE])[_DONE]


def row_names(store: Path) -> list[str]:
    _check_readable(store)
    return _stored(store, [_ROW])[_ROW].tolist()


def read_row(store: Path, row: int) -> xr.Dataset:
    """Read the corrected table of one material from the Zarr store of a run.

    Raises:
        FileFormatError: the row is incomplete or does not exist, or the store is damaged.
    """
    _check_readable(store)
    done = whole_rows(store)
    if not 0 <= row < done.size or not done[row]:
        raise FileFormatError(
            f"{store}: row {row} is incomplete or does not exist: start the run again to complete the store"
        )
    names = [*_VALUES]
    read = read_apart(_DECODER, store, libraries=_LIBRARIES, size=_bytes_of(store, names, row), arrays=names, row=row)
    try:
        sampling = read["attrs"]["sampling"]
        coordinates = {name: (name, v, {"units": "rad"}) for name, v in merl_grid(sampling)._asdict().items()}
        data = {
            name: (DIMS[: read["values"][name].ndim], read["values"][name], {**attributes})
            for name, (_, attributes) in _VALUES.items()
        }
        data["brdf"][2]["sampling"] = sampling
        return xr.Dataset(data, coords={**coordinates, "channel": list(CHANNELS)}, attrs=read["attrs"])
    except (KeyError, ValueError) as error:
        raise FileFormatError(
            f"{store}: row {row} cannot be read, because the store is damaged: {error}; delete the store, and start the run "
            "again"
        ) from None


_DECODER, _LIBRARIES = "matcam.files.decoders:decode_rows", ("zarr.storage",)


def _stored(store: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    _zarr()
    size = _bytes_of(store, names)
    return read_apart(_DECODER, store, libraries=_LIBRARIES, size=size, arrays=list(names))["values"]


def _bytes_of(store: Path, names: Sequence[str], row: int | None = None) -> int:
    """Compute the total size of the chunks of the arrays, bytes.

    If `row` is given, only the chunks of this row are counted. A FileFormatError is raised if a chunk is a link.
    """
    total = 0
    for name in names:
        chunks = store / name / "c"
        for folder, folders, files in os.walk(chunks if row is None else chunks / str(row)):
            for entry in (*folders, *files):
                status = Path(folder, entry).lstat()
                if stat.S_ISLNK(status.st_mode):
                    raise FileFormatError(
                        f"{Path(folder, entry)}: the entry is a link in the Zarr store of a run: remove it"
                    )
                total += status.st_size if stat.S_ISREG(status.st_mode) else 0
    return total


def _check_readable(store: Path) -> None:
    """Raise FileFormatError if a store does not have the arrays of a run."""
    _check_arrays(store)
    if not is_file(store / _ROW / DESCRIPTION):
        raise FileFormatError(
            f"{store}: the folder is not the Zarr store of a run, because it has no array {_ROW}: open run.zarr of a run"
        )


def _check_arrays(store: Path) -> None:
    """Check the descriptions of the arrays of a store before decoding.

    A FileFormatError is raised if an array is not from a run.
    """
    for described in sorted([*store.glob(DESCRIPTION), *store.glob(f"*/{DESCRIPTION}")]):
        name = described.parent.name
        try:
            document = read_json(described, "a description of a run's Zarr store")
            if described.parent == store:
                continue  # description of the group, whose attributes are read in a separate process
            check_codecs(store, name, document)
            shape, chunks, kind = tuple(document["shape"]), chunk_shape(document), document["data_type"]
            check_lengths(store, name, shape)
            if document["chunk_key_encoding"] != {"name": "default", "configuration": {"separator": "/"}}:
                raise FileFormatError(f"{described}: the names of the chunks must be those of a run")
            expected: tuple[tuple[int, ...], tuple[int, ...], str]
            if name in _VALUES:
                expected = (_SIZES, (1, *_SIZES), np.dtype(_VALUES[name][0]).name)
            elif name in (_ROW, _DONE):
                expected = ((), (_NAMES_A_CHUNK if name == _ROW else 1,), "string" if name == _ROW else "bool")
            else:
                continue  # this array is never opened
            if shape[0] > _MOST_ROWS:
                raise FileFormatError(
                    f"{described}: the array is for {shape[0]} materials, but a run has at most {_MOST_ROWS}"
                )
            if (shape[1:], chunks, kind) != expected:
                raise FileFormatError(
                    f"{described}: the array has the shape {shape} and type {kind!r:.20} in chunks of {chunks}, but must have "
                    "the shape, type and chunks of a run"
                )
        except (FileFormatError, KeyError, TypeError, IndexError) as error:
            raise FileFormatError(
                f"{store}: the folder is not the Zarr store of a run: {error}; give run.zarr of a run"
            ) from None


def _create_arrays(group: Any, sampling: Sampling) -> None:
    group.attrs["sampling"] = sampling
    for name, values in merl_grid(sampling)._asdict().items():
        array = group.create_array(
            name, shape=values.shape, dtype=float, dimension_names=(name,), attributes={"units": "rad"}
        )
        array[:] = values
    channels = group.create_array("channel", shape=(len(CHANNELS),), dtype=str, dimension_names=("channel",))
    channels[:] = np.array(CHANNELS, dtype=object)
    for name, (kind, attributes) in _VALUES.items():
        group.create_array(
            name, shape=(0, *_SIZES), chunks=(1, *_SIZES), dtype=kind, attributes=attributes,
            fill_value=False if kind is bool else np.nan, dimension_names=(_ROW, *DIMS),
        )  # fmt: skip
    meaning = {"long_name": "whether the row is complete"}
    group.create_array(_DONE, shape=(0,), chunks=(1,), dtype=bool, dimension_names=(_ROW,), attributes=meaning)
    group.create_array(_ROW, shape=(0,), chunks=(_NAMES_A_CHUNK,), dtype=str, dimension_names=(_ROW,))


def _grow(group: Any, names: list[str]) -> None:
    """Resize the arrays to the given names of all materials.

    The names are written last, because they mark existing rows.
    """
    for name in (*_VALUES, _DONE):
        array = group[name]
        array.resize((len(names), *array.shape[1:]))
    group[_ROW].resize((len(names),))
    group[_ROW][:] = np.array(names, dtype=object)


def _zarr() -> Any:
    checks.extra("a run's Zarr store", "scale", "zarr")
    import zarr

    return zarr
