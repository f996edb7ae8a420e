"""Entries that are read, and entries that are refused in one line."""

import json
import os

import numpy as np
import pytest
import xarray as xr
from benchmarks.recovery import __main__ as command
from benchmarks.recovery import entries

from matcam import write_merl
from matcam.core.grid import brdf_table
from matcam.io import write_netcdf

NAMES = ("coma", "disc")
SHAPE = (90, 90, 180, 3)


def dataset(**variables):
    return xr.Dataset({name: (entries.DIMS, values) for name, values in variables.items()})


@pytest.fixture
def values():
    return np.random.default_rng(0).uniform(0.1, 1, SHAPE)


def test_netcdf_with_error_and_support(tmp_path, values):
    write_netcdf(
        tmp_path / "coma.nc", dataset(brdf=values, brdf_std=0.5 * values, supported=(values > 0.5).astype("i1"))
    )
    (tmp_path / "entry.json").write_text(json.dumps({"name": "mine", "seconds": {"coma": 3}}))
    entry = entries.find(tmp_path, NAMES)
    answer = entries.read(entry.files["coma"])
    assert (entry.name, entry.seconds, entry.memory) == ("mine", {"coma": 3}, {})
    np.testing.assert_array_equal(answer.value, values)
    np.testing.assert_allclose(answer.std, 0.5 * values, rtol=1e-6)
    np.testing.assert_array_equal(answer.supported, values > 0.5)


def test_merl_with_error(tmp_path, values):
    for name, part in (("disc.binary", values), ("disc.std.binary", 0.1 * values)):
        write_merl(tmp_path / name, brdf_table(part, "centre"))
    entry = entries.find(tmp_path, NAMES)
    answer = entries.read(entry.files["disc"])
    assert entry.name == tmp_path.name
    np.testing.assert_allclose(answer.value, values)
    np.testing.assert_allclose(answer.std, 0.1 * values)
    assert answer.supported is None


def test_dimensions_in_another_order(tmp_path, values):
    write_netcdf(tmp_path / "coma.nc", dataset(brdf=values).transpose("channel", "phi_d", "theta_d", "theta_h"))
    np.testing.assert_array_equal(entries.read(tmp_path / "coma.nc").value, values)


def refused(call, *words):
    with pytest.raises(entries.EntryError) as caught:
        call()
    message = str(caught.value)
    assert "\n" not in message
    assert message.isprintable()
    assert len(message) < 400
    assert all(word in message for word in words), message


def test_folders_that_are_refused(tmp_path):
    refused(lambda: entries.find(tmp_path / "gone", NAMES), "no such folder")
    refused(lambda: entries.find(tmp_path, NAMES), "no tables", "coma.nc")
    (tmp_path / "notes.txt").write_text("")
    refused(lambda: entries.find(tmp_path, NAMES), "notes.txt", "remove")
    (tmp_path / "notes.txt").rename(tmp_path / "comma.nc")
    refused(lambda: entries.find(tmp_path, NAMES), "comma.nc", "no case has this name")
    (tmp_path / "comma.nc").rename(tmp_path / "coma.nc")
    (tmp_path / "coma.binary").write_bytes(b"")
    refused(lambda: entries.find(tmp_path, NAMES), "keep one")
    (tmp_path / "coma.binary").unlink()
    (tmp_path / "coma.nc").unlink()
    os.mkfifo(tmp_path / "coma.nc")
    refused(lambda: entries.find(tmp_path, NAMES), "not a regular file")


def test_names_that_do_not_print_are_replaced(tmp_path):
    (tmp_path / "a\x1b[31m\n.nc").write_bytes(b"")
    refused(lambda: entries.find(tmp_path, NAMES), "no case has this name")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[1]", "JSON object"),
        ("{", "entry.json"),
        ('{"name": ""}', "1 to 60 characters"),
        ('{"name": "a\\u001b"}', "printable"),
        ('{"name": 3}', "printable"),
        ('{"seconds": {"coma": -1}}', "seconds"),
        ('{"seconds": {"coma": true}}', "seconds"),
        ('{"memory_mib": {"nothing": 1}}', "memory_mib"),
        ('{"seconds": [1]}', "seconds"),
        ("[" * 100_000, "entry.json"),
    ],
)
def test_documents_that_are_refused(tmp_path, text, words):
    (tmp_path / "coma.nc").write_bytes(b"")
    (tmp_path / "entry.json").write_text(text)
    refused(lambda: entries.find(tmp_path, NAMES), words)


@pytest.mark.parametrize(
    "content", [b"", b"\x89HDF\r\n\x1a\n", b"\x89HDF\r\n\x1a\n" + bytes(5000), b"CDF\x01" + bytes(100)]
)
def test_files_that_are_no_netcdf(tmp_path, content):
    (tmp_path / "coma.nc").write_bytes(content)
    refused(lambda: entries.read(tmp_path / "coma.nc"), "coma.nc")


@pytest.mark.parametrize("size", [0, 11, 12, 1000])
def test_files_that_are_no_merl(tmp_path, size):
    (tmp_path / "coma.binary").write_bytes(np.array([90, 90, 180], "<i4").tobytes()[:size] + bytes(max(size - 12, 0)))
    refused(lambda: entries.read(tmp_path / "coma.binary"), "coma.binary")


def changed(values, **change):
    out = values.copy()
    out[3, 4, 5, 1] = change["to"]
    return out


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda v: xr.Dataset({"rho": (entries.DIMS, v)}), "no variable brdf"),
        (lambda v: dataset(brdf=v[:80]), "shape"),
        (lambda v: xr.Dataset({"brdf": (("a", "b"), v[0, 0])}), "dimensions"),
        (lambda v: dataset(brdf=changed(v, to=np.inf)), "infinities"),
        (lambda v: dataset(brdf=np.full_like(v, np.nan)), "missing"),
        (lambda v: dataset(brdf=v, brdf_std=changed(v, to=-1.0)), "negative"),
        (lambda v: dataset(brdf=v).assign_coords(theta_h=np.linspace(0, 1, 90)), "theta_h"),
        (lambda v: dataset(brdf=v).assign_coords(theta_h=[str(n) for n in range(90)]), "theta_h"),
        (lambda v: dataset(brdf=v.astype("S4")), "real numbers"),
    ],
)  # fmt: skip
def test_tables_that_are_refused(tmp_path, values, make, words):
    make(values).to_netcdf(tmp_path / "coma.nc")
    refused(lambda: entries.read(tmp_path / "coma.nc"), "coma.nc", words)


def test_units_other_than_per_steradian(tmp_path, values):
    data = dataset(brdf=values)
    data["brdf"].attrs["units"] = "1"
    data.to_netcdf(tmp_path / "coma.nc")
    refused(lambda: entries.read(tmp_path / "coma.nc"), "1/sr")


def test_the_command_refuses_in_one_line(tmp_path, capsys):
    assert command.main(["score", str(tmp_path / "gone")]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    seeds = tmp_path / "seeds"
    seeds.write_text("one\ntwo\n")
    assert command.main(["score", str(tmp_path), "--seeds", str(seeds)]) == 1
    assert "not the hidden seeds" in capsys.readouterr().err
    assert command.main(["score", str(tmp_path), "--cases", "nothing"]) == 1
    assert "no case is named nothing" in capsys.readouterr().err
    assert command.main(["run", "--methods", "magic"]) == 1
    assert "no method is named magic" in capsys.readouterr().err
