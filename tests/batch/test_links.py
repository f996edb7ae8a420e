"""No file reads another: links out of a folder are refused by name, and what they lead to goes nowhere."""

import json
import resource
import shutil

import numpy as np
import pytest

from matcam import rigs
from matcam.batch.run import correct_all
from matcam.batch.store import read_row, row_names
from matcam.cli import _run
from matcam.core.errors import FileFormatError, OutputError
from matcam.exchange.conversion import convert
from matcam.files.sidecar import read_sidecar, sidecar_path, write_sidecar
from matcam.io import write_exr
from tests.batch import simple
from tests.batch.tables import write_database


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    return write_database(tmp_path_factory.mktemp("tables"), ["a", "b"])


def corrected(paths, out, **options):
    return correct_all(paths, rigs.merl(), out, workers=1, pages=False, corrector=simple.brighter, **options)


def test_a_table_that_is_a_link(tables, tmp_path, monkeypatch):
    """One that leads out of the folder fails alone; one that stays inside, and one that is named, are read."""
    simple.work_in_this_process(monkeypatch)
    folder = tmp_path / "in"
    folder.mkdir()
    shutil.copyfile(tables / "a.binary", folder / "a.binary")
    (folder / "secret.binary").symlink_to(tables / "b.binary")
    (folder / "inside.binary").symlink_to("a.binary")
    done = corrected([folder], tmp_path / "out")
    assert [failure.source.name for failure in done.failures] == ["secret.binary"]
    assert f"secret.binary: the file is a link to {tables / 'b.binary'}, outside its folder" in done.failures[0].reason
    assert not list((tmp_path / "out").glob("secret*"))
    assert len(done.corrected) == 1
    named = corrected([folder / "secret.binary"], tmp_path / "named")
    assert (len(named.corrected), named.failures) == (1, ())


@pytest.mark.parametrize("name", [".lock", "settings.json", "a.json", "a.nc", "run.zarr", "camera.json", "run.zarr/c"])
def test_a_link_in_a_run_s_folder(tables, tmp_path, name):
    victim, out = tmp_path / "victim", tmp_path / "out"
    victim.write_text("mine")
    (out / name).parent.mkdir(parents=True)
    (out / name).symlink_to(victim)
    with pytest.raises(OutputError, match="is a symbolic link in a run's folder") as caught:
        corrected([tables], out, force=True)
    assert str(out / name) in str(caught.value)
    assert victim.read_text() == "mine"


@pytest.mark.filterwarnings("ignore:.*not have a Zarr V3 specification")
@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("material", {"codecs": [{"name": "numcodecs.pickle"}]}, "coded by 'numcodecs.pickle'"),
        ("material", {"data_type": "object"}, "values of type 'object'"),
        ("material", {"shape": [1 << 40]}, "1099511627776 materials"),
        ("material", {"shape": [-1]}, "has invalid lengths [-1]"),
        ("material", {"zarr_format": 2, "codecs": None}, "not the Zarr store of a run"),
        ("material", {"chunk_key_encoding": {"name": "v2"}}, "the names of the chunks must be those of a run"),
        ("brdf", {"shape": [1, 90, 90, 180, 300]}, "shape (1, 90, 90, 180, 300) and type 'float64'"),
        ("brdf", {"data_type": "float32"}, "type 'float32'"),
        (
            "brdf_std",
            {"chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [9, 90, 90, 180, 3]}}},
            "chunks of (9",
        ),
        ("corrected", {"shape": [1, 1 << 40]}, "shape (1, 1099511627776)"),
    ],
)
def test_a_run_s_zarr_that_others_made(tables, tmp_path, monkeypatch, name, change, words):
    simple.work_in_this_process(monkeypatch)
    corrected([tables / "a.binary"], tmp_path / "out", zarr=True)
    described = tmp_path / "out" / "run.zarr" / name / "zarr.json"
    described.write_text(json.dumps(json.loads(described.read_text()) | change))
    with pytest.raises(FileFormatError, match="not the Zarr store of a run"):
        row_names(tmp_path / "out" / "run.zarr")
    with pytest.raises(OutputError, match="is not the Zarr store of a run") as caught:
        corrected([tables], tmp_path / "out", zarr=True)
    assert words in str(caught.value)


@pytest.mark.filterwarnings("ignore:.*not have a Zarr V3 specification")
def test_a_run_s_zarr_with_a_large_description(tables, tmp_path, monkeypatch):
    """Of the whole group: the library would parse it in this process."""
    simple.work_in_this_process(monkeypatch)
    corrected([tables / "a.binary"], tmp_path / "out", zarr=True)
    described = tmp_path / "out" / "run.zarr" / "zarr.json"
    document = json.loads(described.read_text())
    described.write_text(json.dumps(document | {"attributes": dict.fromkeys(map(str, range(300_000)), 0)}))
    for read in (row_names, lambda store: read_row(store, 0)):
        with pytest.raises(FileFormatError, match="values exceed the limit"):
            read(described.parent)
    with pytest.raises(OutputError, match=r"^output .*is not the Zarr store of a run: .*values exceed the limit"):
        corrected([tables], tmp_path / "out", zarr=True)


@pytest.mark.filterwarnings("ignore:.*not have a Zarr V3 specification")
def test_chunks_of_a_run_s_zarr_that_others_made(tables, tmp_path, monkeypatch):
    simple.work_in_this_process(monkeypatch)
    corrected([tables / "a.binary"], tmp_path / "out", zarr=True)
    store = tmp_path / "out" / "run.zarr"
    assert read_row(store, 0)["brdf"].shape == (90, 90, 180, 3)
    chunk = store / "brdf" / "c" / "0" / "0" / "0" / "0" / "0"
    (tmp_path / "victim").write_bytes(bytes(8 * 90 * 90 * 180 * 3))
    chunk.unlink()
    chunk.symlink_to(tmp_path / "victim")
    with pytest.raises(FileFormatError, match="is a link"):
        read_row(store, 0)
    chunk.unlink()
    chunk.write_bytes(_zstd(bytes(1 << 30)))  # 33 kB
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(FileFormatError):
        read_row(store, 0)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100e3  # KiB: nothing is decoded here
    for row in (-1, 1):
        with pytest.raises(FileFormatError, match="is incomplete"):
            read_row(store, row)


def _zstd(content):
    from numcodecs import Zstd

    return bytes(Zstd().encode(content))


@pytest.fixture
def sections():
    about = rigs.merl().description()
    return {
        "picture": {
            "file": "a.exr", "shape": [4, 5, 3], "quantity": "radiance", "axis_column_px": 2.0, "axis_row_px": 1.5,
        },
        "camera": about["camera"], "sample": about["sample"], "blur": about["blur"],
        "lamp": {"angles_rad": [0.5], "radius_rad": 0.0}, "exposure": None, "material": {},
    }  # fmt: skip


def test_a_sidecar_that_is_a_link(tmp_path, sections):
    """It would carry another's notes into the output."""
    write_sidecar(tmp_path / "victim.json", **sections, notes="secret")
    (tmp_path / "in").mkdir()
    write_exr(tmp_path / "in" / "a.exr", np.ones((4, 5, 3)))
    sidecar_path(tmp_path / "in" / "a.exr").symlink_to(tmp_path / "victim.json")
    with pytest.raises(FileFormatError, match=r"is a link to .*, outside its folder"):
        convert(tmp_path / "in" / "a.exr", tmp_path / "b.tif")
    assert not list(tmp_path.glob("b.tif*"))


@pytest.mark.parametrize("name", ["..", ".", "/etc/passwd", "../a.exr", "a\\b.exr", ""])
def test_a_sidecar_that_names_a_path(tmp_path, sections, name):
    write_sidecar(tmp_path / "a.json", **sections)
    document = json.loads((tmp_path / "a.json").read_text())
    document["picture"]["file"] = name
    (tmp_path / "a.json").write_text(json.dumps(document))
    with pytest.raises(FileFormatError, match=r"field picture\.file"):
        read_sidecar(tmp_path / "a.json")


def test_photographs_that_are_links(tmp_path, capsys):
    (tmp_path / "in").mkdir()
    (tmp_path / "secret.png").write_bytes(b"secret")
    (tmp_path / "in" / "a.png").symlink_to(tmp_path / "secret.png")
    assert _run(["calibrate", str(tmp_path / "in"), "-o", str(tmp_path / "camera.json")]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "a.png: the file is a link to " in said
    assert "secret.png, outside its folder" in said
