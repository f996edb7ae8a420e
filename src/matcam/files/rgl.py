r"""Tensor files of RGL (.bsdf; Dupuy & Jakob 2018): reading and writing of their fields. All values are little-endian.

    byte  0  "tensor_file\0"
         12  uint8, uint8       version 1, 0
         14  uint32             number of fields
         18  fields, each: uint16 length, name; uint16 dimensions; uint8 type (1 u8, 2 i8, 3 u16, 4 i16, 5 u32, 6 i32,
             7 u64, 8 i64, 9 f16, 10 f32, 11 f64); uint64 offset; uint64 shape[dimensions]
          -  values of the fields, row-major; each field starts at a multiple of 8 bytes

Fields of a BRDF, with P azimuths and T angles of the light, N x N nodes of the unit square, and W wavelengths. Rows are
along the azimuth, and columns along theta:

    phi_i [P], theta_i [T]        f32  rad, ascending; an isotropic material has P <= 2
    ndf [., .], sigma [., .]      f32  normal distribution; projected area of the facets seen from a direction
    vndf [P, T, ., .]             f32  density whose inversion maps facet normals to the unit square
    luminance [P, T, N, N]        f32  density of samples on that square
    rgb [P, T, 3, N, N]           f32  on that square; or spectra [P, T, W, N, N] and wavelengths [W], nm
    jacobian [1]                  u8   1: BRDF times cos theta_o is rgb or spectra times ndf / (4 sigma); 0: rgb or spectra
    description                   u8   text

Directions on a unit square: theta = u^2 pi / 2, phi = (2 v - 1) pi, u along the columns. Other fields ("version",
"valid") are copied unchanged. `material/measured.py` describes how the fields define a BRDF.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import xarray as xr

from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.grid import check_unit
from matcam.core.io import replacing
from matcam.core.readers.apart import read_apart
from matcam.core.readers.texts import SMALL_TEXT
from matcam.files.table_decoders import RGL_MAGIC, RGL_TYPES, RGL_VERSION

_CODES = {np.dtype(name): code for code, name in RGL_TYPES.items()}
_ALIGNED = 8  # bytes

_LIGHT = ("phi_i", "theta_i")
_DIMS = {
    "phi_i": ("phi_i",),
    "theta_i": ("theta_i",),
    "ndf": ("ndf_phi", "ndf_theta"),
    "sigma": ("sigma_phi", "sigma_theta"),
    "vndf": (*_LIGHT, "vndf_phi", "vndf_theta"),
    "luminance": (*_LIGHT, "row", "column"),
    "rgb": (*_LIGHT, "channel", "row", "column"),
    "spectra": (*_LIGHT, "wavelengths", "row", "column"),
    "wavelengths": ("wavelengths",),
}
_ORDER = (
    "version",
    "description",
    *_LIGHT,
    "sigma",
    "ndf",
    "vndf",
    "luminance",
    "wavelengths",
    "spectra",
    "rgb",
    "jacobian",
)


def read_rgl(path: str | Path) -> xr.Dataset:
    """Read a BRDF in RGL's parameterisation.

    Each field of the file becomes a variable of the same name and data type.

    Args:
        path: RGL file (.bsdf).

    Returns:
        Dataset of the fields; `Adaptive` converts it to a material.

    Raises:
        FileFormatError: the file is missing, truncated or not a tensor file, or its fields do not define a BRDF. The
            message contains the wrong byte or field.

    Source:
        Dupuy and Jakob (2018), "An adaptive parameterization for efficient material acquisition and rendering".

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> fields = matcam.exchange.adaptive_grid(matcam.Microfacet(matcam.GGX(0.3), 0.9), square=16)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     matcam.io.write_rgl(Path(folder) / "grey.bsdf", fields)
        ...     sorted(matcam.io.read_rgl(Path(folder) / "grey.bsdf").data_vars)[:4]
        ['description', 'jacobian', 'luminance', 'ndf']
    """
    path = Path(path)
    fields = read_apart("matcam.files.table_decoders:decode_rgl", path, "an RGL file", small=SMALL_TEXT)
    try:
        return _checked(fields).assign_attrs(source=path.name)
    except ArgumentError as error:
        raise FileFormatError(f"{path}: {error}") from None


def write_rgl(path: str | Path, fields: xr.Dataset, *, force: bool = False) -> None:
    """Write a BRDF in RGL's parameterisation.

    Args:
        path: file to write (.bsdf).
        fields: Dataset returned by `read_rgl` or `adaptive_grid`.
        force: True to replace an existing file. Default: False.

    Raises:
        ArgumentError: `fields` is not a Dataset, or does not define a BRDF, or has wrong types or units. The message
            contains the wrong field.
        OutputError: the file cannot be written, or exists and `force` is False.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> fields = matcam.exchange.adaptive_grid(matcam.Microfacet(matcam.GGX(0.3), 0.9), square=16)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "grey.bsdf"
        ...     matcam.io.write_rgl(path, fields)
        ...     path.read_bytes()[:11]
        b'tensor_file'
    """
    if not isinstance(fields, xr.Dataset):
        raise ArgumentError(
            f"fields of an RGL file must be a Dataset (see read_rgl, adaptive_grid), got {type(fields).__name__}"
        )
    names = sorted(map(str, fields.variables), key=lambda n: _ORDER.index(n) if n in _ORDER else len(_ORDER))
    arrays = {name: np.ascontiguousarray(fields[name].values) for name in names}
    unknown = [name for name, array in arrays.items() if array.dtype not in _CODES]
    if unknown:
        raise ArgumentError(
            f"field {unknown[0]} has the type {arrays[unknown[0]].dtype}, which cannot be stored: use integers or floats"
        )
    check_fields(fields)
    for name, unit in (("phi_i", "rad"), ("theta_i", "rad"), ("wavelengths", "nm")):
        if name in fields:
            check_unit(f"field {name}", fields[name], unit)
    at = len(RGL_MAGIC) + len(RGL_VERSION) + 4 + sum(13 + len(n.encode()) + 8 * a.ndim for n, a in arrays.items())
    head = [RGL_MAGIC, RGL_VERSION, struct.pack("<I", len(arrays))]
    for name, array in arrays.items():
        at = _next_aligned(at)
        head += [struct.pack("<H", len(name.encode())), name.encode()]
        head.append(struct.pack(f"<HBQ{array.ndim}Q", array.ndim, _CODES[array.dtype], at, *array.shape))
        at += array.nbytes
    with replacing(path, force=force) as temporary, temporary.open("wb") as file:
        file.write(b"".join(head))
        for array in arrays.values():
            file.write(bytes(_next_aligned(file.tell()) - file.tell()))
            file.write(array.astype(array.dtype.newbyteorder("<"), copy=False).tobytes())


def check_fields(fields: xr.Dataset) -> xr.Dataset:
    """Check the fields of a BRDF, and label their dimensions.

    The message of an ArgumentError contains the wrong field.
    """
    return _checked({str(name): field.values for name, field in fields.variables.items()})


def _next_aligned(at: int) -> int:
    return -(-at // _ALIGNED) * _ALIGNED


def _checked(fields: dict[str, np.ndarray]) -> xr.Dataset:
    colour = "spectra" if "wavelengths" in fields else "rgb"
    required = (*_LIGHT, "ndf", "sigma", "vndf", "luminance", "jacobian", colour)
    missing = [name for name in required if name not in fields]
    if missing:
        raise ArgumentError(
            f"field {missing[0]} is missing, so the data are not a BRDF in RGL's parameterisation: add this field"
        )
    for name, dims in _DIMS.items():
        if name in fields:
            array = fields[name]
            if array.dtype != np.float32 or array.ndim != len(dims) or 0 in array.shape:
                raise ArgumentError(
                    f"field {name} must be float32 with dims {dims}, got {array.dtype} of shape {array.shape}"
                )
            if not np.all(np.isfinite(array)):
                raise ArgumentError(
                    f"field {name} must contain finite numbers, got {array[~np.isfinite(array)].flat[0]}"
                )
    if fields["jacobian"].dtype != np.uint8 or fields["jacobian"].shape != (1,):
        raise ArgumentError("field jacobian must be a single uint8 value")
    labelled = {
        name: (_DIMS.get(name, tuple(f"{name}_{i}" for i in range(array.ndim))), array)
        for name, array in fields.items()
    }
    try:
        data = xr.Dataset(labelled)
    except ValueError as error:
        raise ArgumentError(f"the shapes of the fields must agree: {str(error).splitlines()[0]:.150}") from None
    _check_numbers(data, colour)
    return data


def _check_numbers(data: xr.Dataset, colour: str) -> None:
    for name in (*_LIGHT, *(["wavelengths"] if colour == "spectra" else [])):
        if np.any(np.diff(data[name].values) <= 0):
            raise ArgumentError(f"field {name} must increase strictly")
    for name in ("phi_i", "theta_i"):
        if np.abs(data[name].values).max() > 6.3:
            raise ArgumentError(f"field {name} must contain angles in rad, got {np.abs(data[name].values).max():g}")
    for name in ("ndf", "sigma", "vndf", "luminance"):
        if min(data[name].shape[-2:]) < 2:
            raise ArgumentError(f"field {name} must have at least 2 x 2 values, got {data[name].shape[-2:]}")
        if data[name].values.min() < 0:
            raise ArgumentError(f"field {name} must not be negative, got {data[name].values.min():g}")
    if data["sigma"].values.min() <= 0:
        raise ArgumentError(
            f"field sigma must be positive, because values are divided by it, got {data['sigma'].values.min():g}"
        )
    for name in ("vndf", "luminance"):
        if not np.all(np.max(data[name].values, axis=(2, 3)) > 0):
            raise ArgumentError(
                f"field {name} must have a positive value for every direction of the light: give a table without missing "
                "directions"
            )
    if data.sizes["row"] != data.sizes["column"]:
        raise ArgumentError(f"field luminance must be square, got {data.sizes['row']} x {data.sizes['column']}")
    if colour == "rgb" and data.sizes["channel"] != 3:
        raise ArgumentError(f"field rgb must have 3 channels, got {data.sizes['channel']}")
