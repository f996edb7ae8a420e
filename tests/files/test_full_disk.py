"""A disk that is full: every writer says so in one line, and leaves nothing and no half."""

import os
import resource
import signal
import subprocess
import sys

import numpy as np
import pytest
import tifffile
import xarray as xr
from matplotlib.figure import Figure

from matcam import BoxPixel, Camera, GaussianOptics, io
from matcam.core.errors import OutputError
from matcam.core.io import write_columns
from matcam.figures.style import save

PICTURE = np.random.default_rng(3).random((40, 50, 3))
RESULT = xr.Dataset({"raw": ("theta_d", np.random.default_rng(4).random(5000))}, {"theta_d": np.arange(5000.0)})


def figure(path):
    axes = Figure().add_subplot()
    axes.imshow(PICTURE)
    save(axes.figure, path)


def profile(path):
    Camera(GaussianOptics(0.5), BoxPixel(0.5)).save(path)


WRITERS = {
    "a.exr": lambda path: io.write_exr(path, PICTURE),
    "a.tif": lambda path: io.write_float_tiff(path, PICTURE),
    "a.nc": lambda path: io.write_netcdf(path, RESULT),
    "a.zarr.zip": lambda path: io.write_zarr(path, RESULT),
    "a.csv": lambda path: write_columns(path, RESULT),
    "a.json": profile,
    "a.png": figure,
    "a.pdf": figure,
    "a.svg": figure,
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk(tmp_path, name):
    """A limit of the size of files stands in for it."""
    WRITERS[name](tmp_path / name)  # whatever is imported and cached on the way
    size = (tmp_path / name).stat().st_size
    (tmp_path / name).unlink()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    for share in (0.0, 0.5, 0.99):
        resource.setrlimit(resource.RLIMIT_FSIZE, (int(share * size), before[1]))
        try:
            with pytest.raises(OutputError) as caught:
                WRITERS[name](tmp_path / name)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        assert f"{name} cannot be written: " in str(caught.value)
        assert "\n" not in str(caught.value)
        assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_an_interruption_while_files_appear_says_that_they_are_written(tmp_path, name):
    code = (
        "import pathlib, signal, sys\nfrom matcam.cli import main\nreplace = pathlib.Path.replace\n"
        "def interrupted(self, target):\n    signal.raise_signal(getattr(signal, sys.argv[2]))\n"
        "    return replace(self, target)\n"
        "pathlib.Path.replace = interrupted\n"
        "main(['chart', 'star', '-o', sys.argv[1]])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "a.svg"), name], capture_output=True, text=True, check=False
    )
    assert done.returncode == 128 + getattr(signal, name)
    assert done.stderr == "matcam: interrupted after the files were written; they are complete\n"
    assert sorted(os.listdir(tmp_path)) == ["a.json", "a.svg"]


def test_a_capture_that_does_not_fit_leaves_no_folder(tmp_path):
    photographs = tmp_path / "photographs"
    photographs.mkdir()
    tifffile.imwrite(photographs / "a.tif", np.zeros((200, 200), np.uint16))
    for arguments in ([], ["--from", str(photographs)]):
        code = (
            "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
            "from matcam.cli import main\nresource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\nmain(sys.argv[1:])"
        )
        done = subprocess.run(
            [sys.executable, "-c", code, "capture", "init", str(tmp_path / "new" / "shots"), *arguments],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 2
        assert "cannot be written: File too large" in done.stderr
        assert os.listdir(tmp_path) == ["photographs"]
