"""BRDF samples as text (CSV), one pair of directions per line, for exchange with other programs and goniophotometers.

    theta_h_rad,theta_d_rad,phi_d_rad,R_per_sr,G_per_sr,B_per_sr
    0.0123,0.5,1.2,0.31,0.30,0.28

The first line names the columns, in any order. Names of angles end in _deg or _rad. There are two choices of angles:
half and difference angles (theta_h, theta_d, phi_d), or the directions of light and view relative to the surface normal
(theta_i, phi_i, theta_o, phi_o). Every other column is a channel of the BRDF, and its name must end in _per_sr. An
empty value is missing. Values are written with all digits.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import xarray as xr

from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.grid import (
    CHANNELS,
    SAMPLINGS,
    brdf_table,
    check_unit,
    checked_table,
    half_and_difference,
    in_order,
    merl_grid,
)
from matcam.core.io import replacing
from matcam.core.readers.apart import read_apart
from matcam.core.readers.texts import SMALL_TEXT
from matcam.core.results.labelled import named
from matcam.files.table_decoders import HALF as _HALF
from matcam.files.table_decoders import PAIR as _PAIR
from matcam.files.table_decoders import VALUE as _VALUE

_ON_THE_GRID = 1e-6  # largest difference of the angles of a sample from those of its cell, rad


def samples_of(table: xr.DataArray) -> xr.DataArray:
    """Convert a table to samples, dims (sample, channel).

    Cells that are missing in all channels are omitted.
    """
    stacked = checked_table(table).transpose("phi_d", "theta_d", "theta_h", "channel")
    known = np.isfinite(stacked.values).any(axis=-1)
    angles = np.meshgrid(*(stacked[name].values for name in reversed(_HALF)), indexing="ij")[::-1]
    return samples_from(stacked.values[known], [a[known] for a in angles], [str(c) for c in stacked["channel"].values])


def table_of(samples: xr.DataArray) -> xr.DataArray:
    """Build a table from samples. Cells without a sample are missing.

    Samples are not interpolated. An ArgumentError is raised if a sample is not on the MERL grid, if two samples are in
    one cell, or if the channels are neither one for all colours nor R, G and B.
    """
    samples = in_order(checked_samples(samples), "samples")
    labels = [str(label) for label in samples["channel"].values]
    if len(labels) not in (1, len(CHANNELS)) or (len(labels) == 1 and labels[0] in CHANNELS):
        raise ArgumentError(
            f"samples must have one channel for all colours, or the channels R, G and B, got {', '.join(labels)[:60]}"
        )
    found = {name: np.asarray(samples[name].values) for name in _HALF}
    found["phi_d"] = np.mod(found["phi_d"] + _ON_THE_GRID, np.pi) - _ON_THE_GRID  # 180 degrees is equivalent to 0
    for sampling in SAMPLINGS:
        grid = merl_grid(sampling)._asdict()
        nearest = [_nearest(grid[name], found[name]) for name in _HALF]
        apart = [np.abs(found[name] - grid[name][i]) for name, i in zip(_HALF, nearest, strict=True)]
        if all(np.max(a, initial=0) < _ON_THE_GRID for a in apart):
            break
    else:
        worst = int(np.argmax(np.max(apart, axis=0)))
        where = ", ".join(f"{name} {np.degrees(found[name][worst]):.4f}" for name in _HALF)
        raise ArgumentError(
            f"sample {worst + 1} ({where} degrees) must lie on the MERL grid, because samples are not interpolated: "
            "resample the samples to this grid first"
        )
    values = np.full((*(g.size for g in grid.values()), len(CHANNELS)), np.nan)
    numbers = np.ravel_multi_index(tuple(nearest), values.shape[:3])
    if np.unique(numbers).size < numbers.size:
        twice = int(np.flatnonzero(np.bincount(numbers) > 1)[0])
        cell = tuple(int(i) for i in np.unravel_index(twice, values.shape[:3]))
        raise ArgumentError(f"cell {cell} of the MERL grid has several samples: give one sample per cell")
    values[tuple(nearest)] = samples.values
    return brdf_table(values, sampling)


def checked_samples(samples: xr.DataArray) -> xr.DataArray:
    """Check samples of a BRDF, dims (sample, channel).

    An ArgumentError is raised for wrong dims, coordinates, labels or units.
    """
    if not isinstance(samples, xr.DataArray) or samples.dims != ("sample", "channel"):
        dims = getattr(samples, "dims", type(samples).__name__)
        raise ArgumentError(f"samples must have dims (sample, channel) (see read_samples), got {dims}")
    if samples.dtype.kind not in "fiu":
        raise ArgumentError(f"samples must contain real numbers, got {samples.dtype}")
    check_unit("samples", samples, "1/sr")
    for name in _HALF:
        if name not in samples.coords or samples[name].dims != ("sample",) or samples[name].dtype.kind not in "fiu":
            raise ArgumentError(f"samples must have a numeric coordinate {name} along the dimension sample")
        check_unit(f"coordinate {name}", samples[name], "rad")
    labels = [str(label) for label in samples["channel"].values]
    usable = all(re.fullmatch(r"[^,\x00-\x1f\"]{1,60}", label) for label in labels)  # as names of columns
    if "channel" not in samples.coords or len(set(labels)) < len(labels) or not usable:
        raise ArgumentError(
            "samples must have a coordinate channel with a different label for each channel, of 1 to 60 characters without "
            f"commas, quotes and control characters, got {', '.join(labels)!r:.60}"
        )
    return samples


def _nearest(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    above = np.clip(np.searchsorted(axis, angle), 1, axis.size - 1)
    return np.where(angle - axis[above - 1] < axis[above] - angle, above - 1, above)


def write_samples(path: str | Path, samples: xr.DataArray, *, force: bool = False) -> None:
    r"""Write BRDF samples as CSV, angles in rad.

    Args:
        path: file to write (.csv).
        samples: values in 1/sr, such as those returned by `read_samples`, dims (sample, channel), with the coordinates
            theta_h, theta_d and phi_d in rad.
        force: True to replace an existing file. Default: False.

    Raises:
        ArgumentError: `samples` has wrong dims, units or labels.
        OutputError: the file cannot be written, or exists and `force` is False.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> text = "theta_h_deg,theta_d_deg,phi_d_deg,Y_per_sr\n0,30,90,0.25\n"
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "a.csv"
        ...     _ = path.write_text(text)
        ...     matcam.io.write_samples(path, matcam.io.read_samples(path), force=True)
        ...     print(path.read_text().splitlines()[0])
        theta_h_rad,theta_d_rad,phi_d_rad,Y_per_sr
    """
    import pandas as pd

    samples = checked_samples(samples)
    columns = {f"{name}_rad": samples[name].values for name in _HALF}
    columns |= {f"{c}{_VALUE}": samples.values[:, k] for k, c in enumerate(samples["channel"].values)}
    with replacing(path, force=force) as temporary:
        pd.DataFrame(columns).to_csv(temporary, index=False)


def read_samples(path: str | Path) -> xr.DataArray:
    r"""Read BRDF samples from CSV.

    Args:
        path: CSV file whose first line names its columns, such as theta_h_deg or R_per_sr.

    Returns:
        Values in 1/sr, dims (sample, channel); missing values are NaN. Coordinates theta_h, theta_d and phi_d are in
        rad.

    Raises:
        FileFormatError: the file is missing, a column is unknown or missing, a line is not numeric, an angle is out of
            its range, a value is infinite, or all values are missing. The message contains the wrong line.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "a.csv"
        ...     _ = path.write_text("theta_h_deg,theta_d_deg,phi_d_deg,Y_per_sr\n0,30,90,0.25\n")
        ...     samples = matcam.io.read_samples(path)
        >>> samples.values, samples["theta_d"].values.round(4)
        (array([[0.25]]), array([0.5236]))
    """
    path = Path(path)
    decoder = "matcam.files.table_decoders:decode_csv"
    stored = read_apart(decoder, path, "a CSV file", libraries=("pandas",), small=SMALL_TEXT)
    names, scale, values = stored["names"], stored["scale"], stored["values"]
    columns = {name: values[:, k] * scale[k] for k, name in enumerate(names)}
    angles = _PAIR if set(_PAIR) <= set(names) else _HALF
    channels = [name for name in names if name not in angles]
    _check(path, {name: columns[name] for name in angles}, values[:, [names.index(c) for c in channels]])
    in_half = [columns[name] for name in angles]
    if angles == _PAIR:
        in_half = [np.asarray(a) for a in half_and_difference(*in_half)]
    brdf = np.stack([columns[name] for name in channels], axis=-1)
    return samples_from(brdf, in_half, channels).assign_attrs(source=path.name)


def samples_from(values: np.ndarray, angles: list[np.ndarray], channels: list[str]) -> xr.DataArray:
    """Build samples of a BRDF from arrays.

    `values` is the BRDF, 1/sr, (samples, channels). `angles` contains theta_h, theta_d and phi_d, rad, (samples,) each.
    `channels` contains the labels of the channels.
    """
    coords = {name: ("sample", angle, {"units": "rad"}) for name, angle in zip(_HALF, angles, strict=True)}
    attrs = {"units": "1/sr", "long_name": "BRDF"}
    return named(
        xr.DataArray(
            values, dims=("sample", "channel"), coords={**coords, "channel": channels}, name="brdf", attrs=attrs
        )
    )


def _check(path: Path, angles: dict[str, np.ndarray], values: np.ndarray) -> None:
    for name, angle in angles.items():
        low, high = (0.0, np.pi / 2) if name.startswith("theta") else (-2 * np.pi, 2 * np.pi)
        wrong = ~((angle >= low - 1e-9) & (angle <= high + 1e-9))
        if wrong.any():
            line = int(np.flatnonzero(wrong)[0])
            raise FileFormatError(
                f"{path}: line {line + 2}: {name} must lie in [{np.degrees(low):g}, {np.degrees(high):g}] degrees, "
                f"got {np.degrees(angle[line]):g}"
            )
    if np.isinf(values).any():
        line = int(np.flatnonzero(np.isinf(values).any(axis=1))[0])
        raise FileFormatError(f"{path}: line {line + 2} has an infinite value: leave missing values empty")
    if not np.isfinite(values).any():
        raise FileFormatError(f"{path}: every value is missing: give a file with at least one value")
