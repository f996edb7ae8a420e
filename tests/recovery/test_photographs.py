"""Photographs of the benchmark: light, noise, lookup, judged cells, files, and draws of hidden cases."""

import json
from functools import cache

import numpy as np
import pytest
import xarray as xr
from benchmarks.recovery import __main__ as command
from benchmarks.recovery import baselines, cases, entries, generate, photographs, run, scoring

from tests.oracle.merl_lobe import THETA_D
from tests.oracle.sphere_cells import GGX, Setup
from tests.oracle.whole_tables import Body, Case, truth

WIDE = cases.RecoveryCase(
    Case("wide", cases.metal(GGX(0.3), cases.CHROMIUM), Setup(), cases.KNOWN, 0.005, 5e-5, 0.01),
    "Gaussian", photographs.RULE, (0.3, -0.2),
)  # fmt: skip
BODY = WIDE._replace(table=WIDE.table._replace(terms=(*WIDE.table.terms, Body((0.2, 0.4, 0.6), 1.5))))


@cache
def made(case=WIDE):
    """Photographs of a lobe so wide that the camera loses nothing of it. Its records are the light of each pixel's centre."""
    kept = {}
    for j in photographs.SLICES:
        position = photographs.positions(case, j)
        x, y = position.T / cases.RADIUS
        z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
        theta = THETA_D[j]
        cos_i = x * np.sin(2 * theta) + z * np.cos(2 * theta)
        lit = (z > 0) & (cos_i > 0)
        cos_h = x * np.sin(theta) + z * np.cos(theta)
        s2 = np.where(lit, 1 / np.where(lit, cos_h, 1) ** 2 - 1, 0)
        light = [term.light(s2, np.where(lit, cos_i, 1), np.where(lit, z, 1)) for term in case.table.terms]
        kept[j] = np.where(lit, np.array(light) / np.where(lit, 4 * z, 1), 0)
    return photographs.exposed(case, kept)


def test_there_are_cases_of_every_kind():
    assert len(photographs.PUBLIC) == 6
    assert all(photographs.is_photographs(case) for case in photographs.PUBLIC)
    assert not any(photographs.is_photographs(case) for case in cases.PUBLIC)
    names = {case.name for case in (*photographs.PUBLIC, *cases.PUBLIC)}
    assert len(names) == 30
    assert sum(case.table.stated is None for case in photographs.PUBLIC) == 1
    assert sum(len(case.table.terms) == 2 for case in photographs.PUBLIC) == 1


def test_what_is_stated_is_plain_and_hides_the_truth():
    facts = json.loads(json.dumps(photographs.stated(WIDE, made())))
    assert set(facts) == {
        "name", "sphere", "pixel_half_width_px", "lens", "lamp_angle_deg", "electrons_per_value", "read_noise_electrons",
        "gain_relative_standard_deviation",
    }  # fmt: skip
    assert facts["sphere"]["centre_px"] == [263.7, 263.8]
    assert facts["lamp_angle_deg"] == [5, 23, 41, 59, 77, 95, 113, 131, 149]


def test_hidden_cases_are_drawn_from_their_seed_alone():
    some = [photographs.hidden_case(f"seed {n}") for n in range(20)]
    assert some[7] == photographs.hidden_case("seed 7")
    assert len({case.name for case in some}) == len({case.phase for case in some}) == 20
    for n, case in enumerate(some):
        assert photographs.is_photographs(case)
        assert case.table.terms == cases.hidden_case(f"seed {n}").table.terms
        assert case.name != cases.hidden_case(f"seed {n}").name


def test_the_pictures_hold_all_of_the_reflected_light():
    """Pixels without gaps: their sum is the integral over the sphere, with the light that the lens spreads beyond the limb."""
    j = photographs.SLICES[4]
    position = photographs.positions(BODY, j)
    found = photographs.records_of(BODY, j, position).sum(1)
    x, w = np.polynomial.legendre.leggauss(200)
    theta, end = THETA_D[j], np.pi / 2
    latitude, longitude = end * x[:, None], theta + (end - theta) * x
    cos = np.cos(latitude)
    cos_o, cos_i, cos_h = cos * np.cos(longitude), cos * np.cos(longitude - 2 * theta), cos * np.cos(longitude - theta)
    area = end * (end - theta) * w[:, None] * w * cos
    for total, term in zip(found, BODY.table.terms, strict=True):
        radiance = term.light(1 / cos_h**2 - 1, cos_i, cos_o) / 4  # the BRDF times both cosines
        assert total == pytest.approx(cases.RADIUS**2 * (radiance * area).sum(), rel=1e-5)


def test_pictures_are_upright_and_without_gaps():
    pictures = made()
    assert pictures.noisy.shape == (9, 529, 529, 3)
    assert np.isfinite(pictures.noisy).all()
    for n, j in enumerate(photographs.SLICES[1:7], 1):
        row, column = np.unravel_index(np.argmax(pictures.clean[n, ..., 0]), (529, 529))
        assert column > 263.7 + 100 * np.sin(THETA_D[j])  # the lamp is to the right
        assert abs(row - 263.8) < 2
    assert (pictures.clean[:, 0] == 0).all()


def test_noise_is_that_of_electrons():
    pictures = made()
    assert pictures.unit * pictures.clean.max() == pytest.approx(40_000)
    assert pictures.read == pytest.approx(2)
    dark = pictures.noisy[:, :6] * pictures.unit
    assert dark.std() == pytest.approx(2, rel=0.02)
    electrons = pictures.unit * pictures.clean[3]
    bright = electrons > 5000
    error = (pictures.unit * pictures.noisy[3] - electrons)[bright]
    gain = error.sum() / electrons[bright].sum()
    assert abs(gain) < 0.04
    assert np.std((error - gain * electrons[bright]) / np.sqrt(electrons[bright])) == pytest.approx(1, rel=0.03)


def test_a_plain_lookup_of_sharp_pictures_reads_the_material():
    table = photographs.table(WIDE, made())
    judged = table.judged & (table.true[..., 0] > 0)
    error = table.clean[judged] / table.true[judged] - 1
    assert np.sqrt(np.mean(error**2)) < 0.01
    of_photographs = judged[:, photographs.SLICES]
    error = (table.clean / table.true - 1)[:, photographs.SLICES][of_photographs]
    assert np.abs(error).max() < 0.01


def test_cells_are_judged_within_the_range_of_the_photographs():
    table = photographs.table(WIDE, made())
    seen = table.judged.any((0, 2))
    assert seen[2:75].all()
    assert not seen[:2].any()
    assert not seen[75:].any()
    assert np.isnan(table.recorded[:, ~seen]).all()
    assert np.isfinite(table.recorded[table.judged]).all()
    assert not (table.judged & ~generate.judged_cells()).any()


def test_the_plain_lookup_is_the_recorded_table_and_harms_nothing():
    table, facts = photographs.table(WIDE, made()), photographs.stated(WIDE, made())
    answer = baselines.on_pictures("do nothing", made().noisy, facts)
    np.testing.assert_array_equal(answer[table.judged], table.recorded[table.judged])
    score = scoring.score(table, answer)
    assert score["harm"] == 0
    assert len(score["peak curve"]) == 30
    assert {row["theta_d"] for row in score["rows"] if row["quantity"] == "F"} == set(scoring.BANDS)
    # an answer beyond the range of the photographs is in no score
    answer[:, 75:] = 7.0
    assert run.rounded(scoring.score(table, answer)) == run.rounded(score)


@pytest.mark.parametrize("method", sorted(baselines.RESTORED))
def test_restored_pictures_recover_a_part_of_a_narrow_highlight(method):
    pytest.importorskip("skimage", reason="the extra matcam[benchmark] is not installed")
    facts = photographs.stated(WIDE, made())
    line = np.arange(529.0)
    sharp = np.stack([
        np.exp(-((line[:, None] - 264) ** 2 + (line - round(263.7 + 256 * np.sin(THETA_D[j]))) ** 2) / 2 / 0.8**2)
        for j in photographs.SLICES
    ])  # fmt: skip
    kernel = baselines.effective_kernel(facts)
    blurred = np.array([_convolved(one, kernel) for one in sharp])[..., None] * [1, 0.5, 2]
    found = baselines.restored_pictures(blurred, facts, baselines.RESTORED[method])
    before, after = (np.abs(one[..., 0] - sharp).max((1, 2)) for one in (blurred, found))
    assert (after < 0.6 * before).all()
    np.testing.assert_array_equal(found[:, :200], blurred[:, :200])


def _convolved(image, kernel):
    from scipy.signal import fftconvolve

    return fftconvolve(image, kernel, mode="same")


@pytest.fixture
def public(monkeypatch, tmp_path):
    monkeypatch.setattr(command.cases, "PUBLIC", ())
    monkeypatch.setattr(command.photographs, "PUBLIC", (WIDE,))
    monkeypatch.setattr(photographs, "photographs", lambda case, folder=None: made())
    monkeypatch.setattr(generate, "FOLDER", tmp_path / "kept")


def test_the_command_writes_photographs(tmp_path, public):
    assert command.main(["write", str(tmp_path / "out"), "--kind", "photographs", "--truth"]) == 0
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["wide.json", "wide.nc", "wide.truth.nc"]
    with xr.open_dataset(tmp_path / "out" / "wide.nc") as file:
        assert file["photograph"].dims == ("lamp", "row", "column", "channel")
        assert file["photograph"].attrs["units"] == "1/sr"
        np.testing.assert_allclose(file["photograph"], made().noisy, rtol=1e-6, atol=1e-6)
    with xr.open_dataset(tmp_path / "out" / "wide.truth.nc") as file:
        np.testing.assert_allclose(file["brdf"], truth(WIDE.table))
    facts = json.loads((tmp_path / "out" / "wide.json").read_text())
    assert len(facts["lamp_angle_deg"]) == 9


def test_an_entry_is_scored_on_photographs(tmp_path, public, monkeypatch, capsys):
    monkeypatch.setattr(command, "RESULTS", tmp_path / "none.json")
    (tmp_path / "mine").mkdir()
    data = xr.Dataset({"brdf": (entries.DIMS, 1.001 * truth(WIDE.table))})
    data.to_netcdf(tmp_path / "mine" / "wide.nc")
    assert command.main(["score", str(tmp_path / "mine"), "-o", str(tmp_path / "out")]) == 0
    rows = json.loads((tmp_path / "out" / "scores.json").read_text())["mine"]["wide"]["rows"]
    assert max(row["rms"] for row in rows) == pytest.approx(1e-3, rel=1e-6)
    assert command.main(["score", str(tmp_path / "mine"), "--kind", "tables"]) == 1
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert "wide.nc: no case has this name" in message


def test_scores_of_tables_and_photographs_are_published_together(tmp_path, public, monkeypatch):
    score = scoring.score(photographs.table(WIDE, made()), truth(WIDE.table), 0.1 * truth(WIDE.table))
    kept = {method: {"wide": score | {"seconds": 1.0, "memory_mib": 10}} for method in run.METHODS}
    tables = {method: {"coma": score | {"seconds": 1.0, "memory_mib": 10}} for method in run.METHODS}
    (tmp_path / "results.json").write_text(json.dumps({"benchmark": 1, "scores": run.rounded(tables)}))
    for name in ("RESULTS", "PAGE", "PHOTOGRAPHS", "CASES", "README"):
        path = getattr(command, name)
        monkeypatch.setattr(command, name, tmp_path / path.name)
        if name != "RESULTS":
            (tmp_path / path.name).write_text(path.read_text(encoding="utf-8"), encoding="utf-8")
    monkeypatch.setattr(run, "kept_scores", lambda chosen, methods, folder: kept if chosen else {})
    assert command.main(["publish"]) == 0
    document = json.loads((tmp_path / "results.json").read_text())
    assert document["scores"] == run.rounded(tables)
    assert document["photographs"] == run.rounded(kept)
    assert "| `wide` |" in (tmp_path / "recovery-photographs.md").read_text(encoding="utf-8")
    assert "| `coma` |" in (tmp_path / "recovery.md").read_text(encoding="utf-8")
