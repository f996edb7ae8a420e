"""Files made to harm: each is refused in one line that names what it does, and nothing of it is followed, run or filled in."""

import io
import json
import os
import pickle
import re
import struct
import subprocess
import sys
import time
import zipfile
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import xarray as xr

from matcam import Camera, read_merl
from matcam.core.errors import FileFormatError, MatcamError
from matcam.exchange.contents import read_contents
from matcam.files.exposure_series import read_exposure_series
from matcam.files.formats import identify
from matcam.files.photographs import open_photograph
from matcam.files.tone_curve import read_tone_curve
from matcam.io import (
    read_bird,
    read_netcdf,
    read_rgl,
    read_samples,
    read_sidecar,
    read_utia,
    read_zarr,
    read_zemax,
    write_netcdf,
    write_sidecar,
    write_zarr,
)
from matcam.targets import read_chart
from tests.files.test_sidecar import sections

SECRET = np.arange(4.0) + 1000


@pytest.fixture
def result():
    return xr.Dataset({"raw": ("theta_d", np.arange(4.0))}, coords={"channel": ["R", "G"]})


def refused(read, path, words):
    with pytest.raises(MatcamError) as caught:
        read(path)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    assert words in message, message


def hdf5(path, code=""):
    """Make a file by h5py, in a process of its own: two HDF5 libraries need not agree in one."""
    script = f"import h5py, numpy as np\nwith h5py.File({str(path)!r}, 'w') as file:\n    file['x'] = np.arange(4.0)\n"
    script += f"    {code}\n"
    subprocess.run([sys.executable, "-c", script], check=True)
    return path


class TestHDF5:
    @pytest.mark.parametrize(
        ("code", "words"),
        [
            ("file.create_dataset('stolen', (4,), '<f8', external=[('VICTIM', 0, 32)])", "stored in another file"),
            ("file['stolen'] = h5py.ExternalLink('VICTIM', '/x')", "link to another file"),
            (
                "layout = h5py.VirtualLayout((4,), '<f8'); layout[:] = h5py.VirtualSource('VICTIM', 'x', (4,)); "
                "file.create_virtual_dataset('stolen', layout)",
                "assembled from other files",
            ),
            ("file['loop'] = h5py.SoftLink('/loop')", "symbolic link"),
            ("group = file.create_group('g'); group['again'] = group", "is a group"),
            ("file.create_dataset('z', (1 << 27,), '<f8', chunks=(1 << 20,), compression='gzip')", "does not fit into"),
            (
                "file.create_dataset('z', (4,), '<f8', maxshape=(None,), chunks=(1 << 27,), compression='gzip')",
                "does not fit into",
            ),
            (
                "import zlib; one = file.create_dataset('s', (1,), h5py.string_dtype(), chunks=(1,)); one[0] = 'text'; "
                "many = file.create_dataset('t', (400_000,), h5py.string_dtype(), chunks=(400_000,), compression='gzip'); "
                "place = one.id.read_direct_chunk((0,))[1]; many.id.write_direct_chunk((0,), zlib.compress(place * 400_000))",
                "does not fit into",
            ),
            (
                "file.create_dataset('l', (2,), h5py.vlen_dtype('i4'))",
                "contains lists or references",
            ),
            (
                "plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE); plan.set_chunk((4,)); plan.set_deflate(9); "
                "plan.set_deflate(9); h5py.h5d.create(file.id, b'd', h5py.h5t.NATIVE_DOUBLE, "
                "h5py.h5s.create_simple((4,)), plan)",
                "filtered twice by deflate",
            ),
        ],
        ids=["external", "link", "virtual", "symbolic", "cycle", "zeros", "chunk", "texts", "lists", "deflated twice"],
    )
    def test_files_that_reach_out(self, tmp_path, code, words):
        hdf5(tmp_path / "victim.nc")
        path = hdf5(tmp_path / "a.nc", code.replace("VICTIM", str(tmp_path / "victim.nc")))
        refused(read_netcdf, path, words)

    def test_a_plain_file_of_another_writer(self, tmp_path):
        np.testing.assert_array_equal(read_netcdf(hdf5(tmp_path / "a.nc"))["x"], np.arange(4.0))

    def test_from_four_threads(self, result, tmp_path):
        write_netcdf(tmp_path / "a.nc", result)
        with ThreadPoolExecutor(4) as pool:
            for back in pool.map(read_netcdf, [tmp_path / "a.nc"] * 24):
                xr.testing.assert_identical(back, result)


class Harm:
    """What a pickle may do when it is loaded."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (self.path,)


def zip_of(path, members):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for name, content in members.items():
            archive.writestr(name, content if isinstance(content, bytes) else json.dumps(content))
    return path


GROUP = {"zarr_format": 3, "node_type": "group", "attributes": {}}


def array(**changes):
    return {
        "zarr_format": 3, "node_type": "array", "shape": [4], "data_type": "float64", "fill_value": 0.0,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [4]}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "codecs": [{"name": "bytes", "configuration": {"endian": "little"}}], "attributes": {}, "dimension_names": ["x"],
    } | changes  # fmt: skip


class TestZarr:
    def test_a_whole_one_is_read(self, tmp_path):
        path = zip_of(
            tmp_path / "a.zarr.zip", {"zarr.json": GROUP, "raw/zarr.json": array(), "raw/c/0": SECRET.tobytes()}
        )
        np.testing.assert_array_equal(read_zarr(path)["raw"], SECRET)

    def test_version_2_with_a_pickle(self, tmp_path):
        """numcodecs' pickle filter runs whatever its chunk says."""
        chunk = io.BytesIO()
        pickle.dump(np.array([Harm(str(tmp_path / "harm"))], dtype=object), chunk)
        described = {
            "zarr_format": 2, "shape": [1], "chunks": [1], "dtype": "|O", "order": "C", "fill_value": None, "compressor": None,
            "filters": [{"id": "pickle", "protocol": 5}],
        }  # fmt: skip
        path = tmp_path / "a.zarr.zip"
        zip_of(path, {".zgroup": {"zarr_format": 2}, "raw/.zarray": described, "raw/0": chunk.getvalue()})
        with zipfile.ZipFile(path, "a") as archive:
            archive.comment = b"zarr.json"
        assert identify(path) == "zarr"
        refused(read_zarr, path, "version 2")
        assert not (tmp_path / "harm").exists()

    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"codecs": [{"name": "numcodecs.pickle"}]}, "coded by 'numcodecs.pickle'"),
            ({"data_type": "object"}, "values of type 'object'"),
            ({"shape": [1 << 40]}, "does not fit into"),
            ({"chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [1 << 40]}}}, "does not fit into"),
            ({"chunk_grid": {"name": "rectilinear", "configuration": {}}}, "must have regular chunks"),
            ({"storage_transformers": [{"name": "other"}]}, "storage transformers"),
            ({"zarr_format": 2}, "not of Zarr version 3"),
            ({"shape": [-4]}, "has invalid lengths [-4]"),
            ({"shape": [4.0]}, "has invalid lengths [4.0]"),
            ({"shape": [True]}, "has invalid lengths [True]"),
            ({"chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [-4]}}}, "has invalid lengths [-4]"),
        ],
    )
    def test_arrays_beyond_the_list(self, tmp_path, changes, words):
        path = zip_of(
            tmp_path / "a.zarr.zip", {"zarr.json": GROUP, "raw/zarr.json": array(**changes), "raw/c/0": b"\0" * 32}
        )
        refused(read_zarr, path, words)

    def test_a_negative_length_hides_no_other(self, tmp_path):
        """Of an array inside an array, which the library never opens."""
        chunks = {"name": "regular", "configuration": {"chunk_shape": [1000]}}
        members = {
            "zarr.json": GROUP,
            "raw/inner/zarr.json": array(shape=[-4_000_000_000]),
            "raw/zarr.json": array(shape=[1 << 29], chunk_grid=chunks),
        }
        refused(read_zarr, zip_of(tmp_path / "a.zarr.zip", members), "is inside an array")

    def test_no_root(self, tmp_path):
        refused(
            read_zarr,
            zip_of(tmp_path / "a.zarr.zip", {"raw/zarr.json": array()}),
            "its root has no zarr.json of a group",
        )

    def test_members_that_overlap(self, result, tmp_path):
        write_zarr(tmp_path / "a.zarr.zip", result)
        content = bytearray((tmp_path / "a.zarr.zip").read_bytes())
        first = content.index(b"PK\1\2")
        second = content.index(b"PK\1\2", first + 1)
        content[second + 42 : second + 46] = content[first + 42 : first + 46]  # the place of its bytes
        (tmp_path / "b.zarr.zip").write_bytes(content)
        refused(read_zarr, tmp_path / "b.zarr.zip", "overlaps")


@pytest.mark.parametrize(
    "read",
    [identify, read_contents, open_photograph, read_merl, read_netcdf, read_zarr, read_samples, read_zemax, read_utia],
)
def test_what_is_no_file_is_not_opened(tmp_path, read):
    """Nobody will ever write into the pipe; the device never ends."""
    os.mkfifo(tmp_path / "a.nc")
    refused(read, tmp_path / "a.nc", "is a pipe or a device")
    (tmp_path / "b.nc").symlink_to("/dev/zero")
    refused(read, tmp_path / "b.nc", "is a pipe or a device")


def test_a_picture_whose_working_copies_do_not_fit(tmp_path):
    """389 kB that would take 7 GB."""
    header = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sIIBBBBB", 13, b"IHDR", 60_000, 60_000, 8, 0, 0, 0, 0)
    (tmp_path / "a.png").write_bytes(header + b"\0" * 389_000)
    refused(open_photograph, tmp_path / "a.png", "GiB")


def test_a_table_without_values(tmp_path):
    path = tmp_path / "a.binary"
    path.write_bytes(struct.pack("<3i", 90, 90, 180))
    with pytest.raises(FileFormatError):
        read_merl(path)


class TestTexts:
    """Texts that would take minutes and gigabytes: each takes at most 2 s of this process, and no memory to speak of."""

    HEAD = "theta_h_deg,theta_d_deg,phi_d_deg,Y_per_sr\n"

    @pytest.fixture(autouse=True)
    def _quickly(self):
        begin = time.process_time()
        yield
        assert time.process_time() - begin < 2.5

    def test_a_row_of_a_million_values(self, tmp_path):
        (tmp_path / "a.csv").write_text(self.HEAD + "1," * 3_000_000 + "\n")
        refused(read_samples, tmp_path / "a.csv", "line 2 has more than 16384 bytes")

    def test_lines_without_values(self, tmp_path):
        (tmp_path / "a.csv").write_text(self.HEAD + "\n" * 6_000_000)
        refused(read_samples, tmp_path / "a.csv", "has no values below")

    @pytest.mark.parametrize(
        "content",
        [
            "{" + ",".join(f'"key{k}": {k}' for k in range(500_000)) + "}",
            '{"format": "matcam camera profile", "version": 1, "notes": [' + "[]," * 3_000_000 + "0]}",
            "[" * 8_000_000,
        ],
        ids=["keys", "lists", "depth"],
    )
    @pytest.mark.parametrize("read", [Camera.load, read_sidecar, read_chart])
    def test_documents_of_many_values(self, tmp_path, read, content):
        (tmp_path / "a.json").write_text(content)
        refused(read, tmp_path / "a.json", "values exceed the limit")

    def test_a_document_whose_values_are_all_wrong(self, tmp_path):
        """As many as may be: the schema refuses each."""
        write_sidecar(tmp_path / "a.json", **sections())
        text = (tmp_path / "a.json").read_text()
        wrong = ", ".join(f'"{k}"' for k in range(240_000))
        text = re.sub(r'"angles_rad": \[[^]]*\]', lambda _: f'"angles_rad": [{wrong}]', text)
        (tmp_path / "a.json").write_text(text)
        refused(read_sidecar, tmp_path / "a.json", "field lamp.angles_rad.0")

    def test_a_tone_curve_of_many_lines(self, tmp_path):
        (tmp_path / "a.txt").write_text("1\n" * 2_000_000)
        refused(read_tone_curve, tmp_path / "a.txt", "2000000 lines exceed the limit")

    def test_readings_each_of_another_channel(self, tmp_path):
        """40,000 readings whose table would have 13 GB."""
        count = 40_000
        arrays = {
            "theta_i": "0.001",
            "phi_i": "0",
            "theta_r": "{k}e-6",
            "phi_r": "0",
            "BRDF": "1",
            "wavelength_i": "{k}",
        }
        units = {"BRDF": "1/sr", "wavelength_i": "nm"}
        parts = [
            f'"{name}": {{"unit": "{units.get(name, "rad")}", '
            f'"values": [{",".join(value.format(k=k) for k in range(count))}]}}'
            for name, value in arrays.items()
        ]
        (tmp_path / "a.brdf").write_text('{"data": {' + ", ".join(parts) + "}}")
        refused(
            read_bird, tmp_path / "a.brdf", "40000 readings are too few for 40000 pairs of directions in 40000 channels"
        )

    def test_a_zemax_file_of_words(self, tmp_path):
        (tmp_path / "a.bsdf").write_text("SpectralContent " + "1 " * 5_000_000)
        refused(read_zemax, tmp_path / "a.bsdf", "is not a complete BSDF of Zemax")

    def test_a_zemax_file_without_an_end(self, tmp_path):
        with (tmp_path / "a.bsdf").open("wb") as file:
            file.write(b"SpectralContent")
            file.truncate(100 << 30)
        refused(read_zemax, tmp_path / "a.bsdf", "are allowed for a BSDF of Zemax")

    @pytest.mark.parametrize(
        ("line", "words"),
        [
            ("i /etc/passwd", "leads out of the descriptor's folder"),
            ("i ../victim.png", "leads out of the descriptor's folder"),
            ("i C:\\victim.png", "leads out of the descriptor's folder"),
            ("i link/victim.png", "is a link to a file outside the descriptor's folder"),
            ("i " + "x" * 300, "has a name that is not plain text"),
            ("n " + "9" * 900 + " 1 1", "must be n BITS WIDTH HEIGHT"),
            ("i a.png\n" * 90_000, "at most 20000 are allowed"),
        ],
    )
    def test_descriptors_of_exposures_that_reach_out(self, tmp_path, line, words):
        (tmp_path / "in").mkdir()
        (tmp_path / "victim.png").write_bytes(b"")
        (tmp_path / "in" / "link").symlink_to(tmp_path)
        (tmp_path / "in" / "a.txt").write_text(f"n 12 1 1\nb 1 1\n{line}\nd 1\ni d.png\n", encoding="utf-8")
        refused(read_exposure_series, tmp_path / "in" / "a.txt", words)

    def test_an_rgl_file_without_an_end(self, tmp_path):
        """A hole of 100 GB, which nobody reads."""
        with (tmp_path / "a.bsdf").open("wb") as file:
            file.write(b"tensor_file\0\1\0" + struct.pack("<I", 1))
            file.truncate(100 << 30)
        refused(read_rgl, tmp_path / "a.bsdf", "needs more than")
