"""Commands hide Dask from xarray; a cluster uses it."""

import subprocess
import sys

import pytest

_CODE = """
import sys
from matcam.cli import without_dask
with without_dask():
    import numpy, xarray
    xarray.DataArray(numpy.ones(3)).to_netcdf(engine="h5netcdf")
    assert not any(name.startswith(("dask.", "distributed")) for name in sys.modules)
    {inside}
import dask
print(dask.__name__)
"""


@pytest.mark.parametrize(
    "inside",
    [
        "pass",
        "from matcam.batch.executors.cluster import ClusterExecutor; ClusterExecutor('local:1'); import distributed",
    ],
)
def test_arrays_of_numpy_do_not_load_dask(inside):
    pytest.importorskip("distributed")
    code = _CODE.replace("{inside}", inside)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "dask\n"


def test_a_loaded_dask_is_kept():
    code = (
        "import dask, sys\nfrom matcam.cli import without_dask\nwith without_dask(): import dask as again\n"
        "assert sys.modules['dask'] is dask is again"
    )
    pytest.importorskip("dask")
    subprocess.run([sys.executable, "-c", code], check=True)
