from .files.bird import read_bird, write_bird
from .files.datasets import read_netcdf, read_zarr, write_netcdf, write_zarr
from .files.example_data import example_table
from .files.float_pictures import read_exr, read_float_tiff, write_exr, write_float_tiff
from .files.light_positions import LightPosition, read_light_positions, write_light_positions
from .files.rgl import read_rgl, write_rgl
from .files.samples import read_samples, write_samples
from .files.sidecar import read_sidecar, sidecar_path, write_sidecar
from .files.utia import read_utia
from .files.zemax import read_zemax
from .numerics.budget import write_budgets

__all__ = [
    "LightPosition",
    "example_table",
    "read_bird",
    "read_exr",
    "read_float_tiff",
    "read_light_positions",
    "read_netcdf",
    "read_rgl",
    "read_samples",
    "read_sidecar",
    "read_utia",
    "read_zarr",
    "read_zemax",
    "sidecar_path",
    "write_bird",
    "write_budgets",
    "write_exr",
    "write_float_tiff",
    "write_light_positions",
    "write_netcdf",
    "write_rgl",
    "write_samples",
    "write_sidecar",
    "write_zarr",
]
