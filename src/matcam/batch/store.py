"""A run as one Zarr: arrays over all its materials, which `xarray.open_zarr` reads lazily. Needs the extra `matcam[scale]`.

A folder, version 3, dims (material, theta_h, theta_d, phi_d, channel); one chunk a material, so that workers write their rows
beside each other. `corrected` says which rows are whole; it is a row's last chunk.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from matcam.core import checks
from matcam.core.errors import FileFormatError, OutputError
from matcam.core.grid import CHANNELS, DIMS, GRID_SHAPE, Sampling, merl_grid
from matcam.core.io import read_json
from matcam.files.datasets import with_short_deviations
from matcam.files.decoders import DESCRIPTION, check_codecs
from matcam.inverse.correction.corrected_table import TABLE_ATTRIBUTES

_ROW, _DONE = "material", "corrected"
_MOST_ROWS = 10_000_000
_VALUES: dict[str, tuple[type, dict[str, str]]] = {
    name: (bool if name == "supported" else np.float32 if name.endswith("_std") else float, attributes)
    for name, attributes in TABLE_ATTRIBUTES.items()
}
"""Type and attributes of each variable; as in NetCDF, standard deviations have 7 digits."""


class StoreRow(NamedTuple):
    """Name one material's row of a run's Zarr.

    Attributes:
        store: folder of the Zarr.
        row: index along its first dimension.
    """

    store: Path
    row: int

    def write(self, data: xr.Dataset) -> None:
        """Write a corrected table as this row. OutputError if that fails."""
        try:
            group = _zarr().open_group(self.store, mode="r+", zarr_format=3, use_consolidated=False)
            group[_DONE][self.row] = False
            for name, one in with_short_deviations(data[list(_VALUES)]).items():
                group[str(name)][self.row] = one.values
            group[_DONE][self.row] = True
        except (OSError, KeyError) as error:
            reason = getattr(error, "strerror", None) or error
            raise OutputError(f"output {self.store}, row {self.row}, cannot be written: {reason}") from None


def open_rows(store: Path, names: Sequence[str], sampling: Sampling) -> dict[str, StoreRow]:
    """Return the row of each material in a store, which is created or grown as needed.

    ArgumentError if zarr is not installed; OutputError if the store is not one of runs or cannot be written.
    """
    zarr = _zarr()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # text has no final specification in Zarr 3: other readers may not know it
            _check_store(store)
            group = zarr.open_group(store, mode="a", zarr_format=3, use_consolidated=False)
            if _ROW not in group:
                if any(True for _ in group):
                    raise OutputError(f"output {store} is not the Zarr of a run: choose another folder")
                _create_arrays(group, sampling)
            there = [str(name) for name in group[_ROW][:]]
            new = [name for name in names if name not in set(there)]
            if new:
                _grow(group, [*there, *new])
    except (OSError, KeyError, ValueError) as error:
        raise OutputError(f"output {store} cannot be written as the Zarr of a run: {error}") from None
    return {name: StoreRow(store, row) for row, name in enumerate([*there, *new])}


def whole_rows(store: Path) -> np.ndarray:
    """Return which rows hold a corrected table, bool."""
    return np.asarray(_zarr().open_group(store, mode="r", zarr_format=3, use_consolidated=False)[_DONE][:])


def row_names(store: Path) -> list[str]:
    """Return the materials of a run's Zarr, by row; tables are not read."""
    return [str(name) for name in _readable(store)[_ROW][:]]


def read_row(store: Path, row: int) -> xr.Dataset:
    """Read one material's corrected table from a run's Zarr.

    Raises:
        FileFormatError: the row is not whole, or the store is damaged.
    """
    group = _readable(store)
    try:
        if not bool(group[_DONE][row]):
            raise FileFormatError(f"{store}: row {row} is not whole: the run has not finished it")
        grid = merl_grid(group.attrs["sampling"])._asdict()
        coordinates = {name: (name, values, {"units": "rad"}) for name, values in grid.items()}
        said = {"brdf": {"sampling": group.attrs["sampling"]}}
        data = {
            name: (DIMS if name != "response" else DIMS[:3], group[name][row], attributes | said.get(name, {}))
            for name, (_, attributes) in _VALUES.items()
        }
        return xr.Dataset(data, coords={**coordinates, "channel": list(CHANNELS)}, attrs=dict(group.attrs))
    except (OSError, KeyError, ValueError, IndexError) as error:
        raise FileFormatError(f"{store}: row {row} cannot be read: {error}") from None


def _readable(store: Path) -> Any:
    """Open a store, when its arrays have been found to be a run's."""
    try:
        _check_store(store)
        return _zarr().open_group(store, mode="r", zarr_format=3, use_consolidated=False)
    except (OSError, KeyError, ValueError, OutputError) as error:
        raise FileFormatError(f"{store}: not the Zarr of a run: {error}") from None


def _check_store(store: Path) -> None:
    """Check the arrays of a store before anything of it is decoded. OutputError for what no run has written."""
    for described in sorted(store.glob(f"*/{DESCRIPTION}")):
        try:
            document = read_json(described, "an array of a run's Zarr")
            check_codecs(store, described.parent.name, document)
            if document["shape"][0] > _MOST_ROWS and described.parent.name in (_ROW, _DONE):
                raise FileFormatError(f"{described}: {document['shape'][0]} materials")
        except (FileFormatError, KeyError, TypeError, IndexError) as error:
            raise OutputError(f"output {store} is not the Zarr of a run: {error}") from None


def _create_arrays(group: Any, sampling: Sampling) -> None:
    """Create the arrays, without a material yet."""
    group.attrs["sampling"] = sampling
    for name, values in merl_grid(sampling)._asdict().items():
        array = group.create_array(
            name, shape=values.shape, dtype=float, dimension_names=(name,), attributes={"units": "rad"}
        )
        array[:] = values
    channels = group.create_array("channel", shape=(len(CHANNELS),), dtype=str, dimension_names=("channel",))
    channels[:] = np.array(CHANNELS, dtype=object)
    sizes = (*GRID_SHAPE, len(CHANNELS))
    for name, (kind, attributes) in _VALUES.items():
        dims = DIMS if name != "response" else DIMS[:3]
        group.create_array(
            name, shape=(0, *sizes[: len(dims)]), chunks=(1, *sizes[: len(dims)]), dtype=kind,
            fill_value=False if kind is bool else np.nan, dimension_names=(_ROW, *dims), attributes=attributes,
        )  # fmt: skip
    meaning = {"long_name": "whether the row is whole"}
    group.create_array(_DONE, shape=(0,), chunks=(1,), dtype=bool, dimension_names=(_ROW,), attributes=meaning)
    group.create_array(_ROW, shape=(0,), chunks=(4096,), dtype=str, dimension_names=(_ROW,))


def _grow(group: Any, names: list[str]) -> None:
    """Add rows for these materials; their names last, because names say which rows exist."""
    for name in (*_VALUES, _DONE):
        array = group[name]
        array.resize((len(names), *array.shape[1:]))
    group[_ROW].resize((len(names),))
    group[_ROW][:] = np.array(names, dtype=object)


def _zarr() -> Any:
    checks.extra("a run's Zarr", "scale", "zarr")
    import zarr

    return zarr
