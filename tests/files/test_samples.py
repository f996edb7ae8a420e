"""CSV of angles and values."""

import numpy as np
import pytest

from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.grid import brdf_table
from matcam.core.shading import shading
from matcam.files.samples import samples_of, table_of
from matcam.io import read_samples, write_samples
from tests.files.mutations import mutated, survives

HEAD = "theta_h_rad,theta_d_rad,phi_d_rad,R_per_sr,G_per_sr,B_per_sr\n"


@pytest.fixture(scope="module")
def sparse():
    """A table of random values of which one in a thousand is there, some in one channel only."""
    random = np.random.default_rng(1)
    values = np.where(random.random((90, 90, 180, 1)) < 1e-3, random.random((90, 90, 180, 3)), np.nan)
    values[random.random(values.shape) < 0.2] = np.nan
    return brdf_table(values, "edge")


def test_a_table_comes_back_to_the_bit(sparse, tmp_path):
    write_samples(tmp_path / "a.csv", samples_of(sparse))
    back = table_of(read_samples(tmp_path / "a.csv"))
    np.testing.assert_array_equal(back.values, sparse.values)
    assert back.attrs["sampling"] == "edge"
    assert (tmp_path / "a.csv").read_text().startswith(HEAD)


def test_angles_of_light_and_view_in_degrees(tmp_path):
    """Against the same pair as vectors."""
    random = np.random.default_rng(2)
    theta_i, theta_o = random.uniform(0, 80, (2, 50))
    phi_i, phi_o = random.uniform(-180, 180, (2, 50))
    lines = ["G_per_sr,theta_o_deg,phi_i_deg,theta_i_deg,phi_o_deg"]
    lines += [
        f"0.5,{c!r},{b!r},{a!r},{d!r}" for a, b, c, d in np.stack([theta_i, phi_i, theta_o, phi_o], axis=-1).tolist()
    ]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    found = read_samples(tmp_path / "a.csv")
    i, o = (
        (np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t))
        for t, p in (np.radians((theta_i, phi_i)), np.radians((theta_o, phi_o)))
    )
    seen = shading((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), i, o)
    slope = np.hypot(seen.slope_along, seen.slope_across)
    np.testing.assert_allclose(np.tan(found["theta_h"]), slope, rtol=1e-10)
    np.testing.assert_allclose(found["theta_d"], seen.theta_d, rtol=1e-10)
    np.testing.assert_allclose(np.exp(1j * found["phi_d"].values), np.exp(1j * np.asarray(seen.phi_d)), atol=1e-10)
    assert found.dims == ("sample", "channel")
    assert list(found["channel"].values) == ["G"]


def test_what_is_wrong_is_said_with_its_line(tmp_path):
    good = HEAD + "0.1,0.2,0.3,1,2,3\n"
    cases = [
        ("", "line 1"),
        ("a,b\n1,2\n", "column 'a' is neither"),
        (HEAD, "has no values below"),
        (HEAD.replace("theta_d_rad,", ""), "line 1 must name"),
        (HEAD.replace("phi_d_rad", "theta_h_deg") + "1,1,1,1,1,1", "line 1 must name"),
        ("theta_h_rad,theta_d_rad,phi_d_rad\n1,1,1\n", "at least one channel"),
        (HEAD.replace("R_per_sr", "theta_i_rad") + "1,1,1,1,1,1", "not both"),
        (good + "0.1,x,0.3,1,2,3\n", "line"),
        (good + "0.1,0.2,0.3,1,2,3,4\n", "line"),
        (good + "0.1,1.6,0.3,1,2,3\n", "line 3: theta_d must lie in [0, 90] degrees, got 91.67"),
        (good + "0.1,,0.3,1,2,3\n", "line 3: theta_d"),
        (good + "0.1,0.2,0.3,inf,2,3\n", "line 3 has an infinite"),
        (HEAD + "0.1,0.2,0.3,,,\n", "every value is missing"),
        ("\xff\xfe\n", "line 1"),
    ]
    for text, words in cases:
        (tmp_path / "a.csv").write_text(text, encoding="latin-1")
        with pytest.raises(FileFormatError) as caught:
            read_samples(tmp_path / "a.csv")
        assert words in str(caught.value), text
        assert "\n" not in str(caught.value)
    for path, words in ((tmp_path / "none.csv", "no such file"), (tmp_path, "folder")):
        with pytest.raises(FileFormatError, match=words):
            read_samples(path)


def test_scattered_samples_are_no_table(tmp_path):
    (tmp_path / "a.csv").write_text(HEAD + "0.1,0.2,0.3,1,2,3\n")
    with pytest.raises(ArgumentError, match=r"sample 1 .* must lie on the MERL grid"):
        table_of(read_samples(tmp_path / "a.csv"))
    (tmp_path / "b.csv").write_text(HEAD + "0,0,0,1,2,3\n0,0,3.141592653589793,1,2,3\n")
    with pytest.raises(ArgumentError, match="several samples"):
        table_of(read_samples(tmp_path / "b.csv"))


@pytest.mark.parametrize("count", [300, pytest.param(10_000, marks=pytest.mark.slow)])
def test_damaged_files(sparse, tmp_path, count):
    write_samples(tmp_path / "a.csv", samples_of(sparse))
    content = b"\n".join((tmp_path / "a.csv").read_bytes().split(b"\n")[:200])
    refused, accepted = survives(read_samples, tmp_path / "b.csv", mutated(content, count, 2, len(HEAD)))
    assert refused > count / 3
    assert accepted > 0
