"""One camera for a run: the oracle's tables, their blur told wrong."""

import functools
import json
from types import SimpleNamespace

import numpy as np
import pytest

from matcam import Camera, rigs, write_merl
from matcam.batch import recipe as shared_camera
from matcam.batch.run import correct_all
from matcam.core.errors import FitError
from matcam.core.grid import brdf_table
from tests.batch import simple
from tests.batch.tables import write_database
from tests.inverse import recorded
from tests.oracle import sphere_cells as oracle
from tests.oracle.merl_lobe import conductor


@pytest.fixture
def here(monkeypatch):
    simple.work_in_this_process(monkeypatch)


@pytest.mark.slow
def test_the_blur_is_found_and_used(tmp_path, here):
    """Two materials recorded through 0.5 px, said to be 0.55 px: the camera is fitted to both, with an error that holds, every
    job is told of it, and the run that is taken up again does not fit it anew."""
    shot = recorded.pictures(6)
    theta = shot.cells.theta_d[:, None, None]
    for seed, alpha in enumerate((0.003, 0.012)):
        directions = shot.rule.directions(oracle.GGX(alpha)) * conductor(theta, *recorded.CHROMIUM)
        one = shot.table(shot.rule.noisy(directions, np.random.default_rng(seed), gain=0.01)).values
        write_merl(tmp_path / f"m{seed}.binary", brdf_table(np.repeat(one, 3, axis=3).clip(min=0), "centre"))
    (tmp_path / "short.binary").write_bytes(b"short")
    again = lambda: correct_all(  # noqa: E731
        [tmp_path], recorded.rig(0.55), tmp_path / "out", "ggx", fit_camera=True, corrector=simple.records_lens
    )
    done = again()
    assert len(done.corrected) == 2
    camera = Camera.load(tmp_path / "out" / "camera.json")
    sigma, std = float(camera.optics.sigma), camera.uncertainty.std()["optics.sigma_px"]
    print(f"sigma {sigma:.5f} +- {std:.5f} px")
    assert std < 0.005
    assert abs(sigma - 0.5) < 4 * std
    records = [json.loads((tmp_path / "out" / f"m{seed}.json").read_text()) for seed in range(2)]
    assert [one["lens"] for one in records] == [sigma, sigma]
    assert records[0]["camera"]["uncertainty"]["covariance"][0][0] == pytest.approx(std**2)
    written = (tmp_path / "out" / "camera.json").stat().st_mtime_ns
    resumed = again()
    assert (len(resumed.kept), resumed.corrected) == (2, ())
    assert (tmp_path / "out" / "camera.json").stat().st_mtime_ns == written


def test_a_blur_that_does_not_show_is_not_used(tmp_path, here, monkeypatch):
    """As in tables without a camera; the folder stays free for a run without --fit-camera."""
    write_database(tmp_path / "in", ["a"])
    fitted = SimpleNamespace(
        params={"optics.sigma_px": 0.01}, std={"optics.sigma_px": 0.02}, camera=rigs.merl().camera, log_likelihood=0.0
    )
    monkeypatch.setattr(shared_camera, "candidate_fits", lambda *arguments, **options: [fitted])
    start = functools.partial(
        correct_all, [tmp_path / "in"], rigs.merl(), tmp_path / "out", corrector=simple.records_lens
    )
    with pytest.raises(FitError, match=r"a\.binary do not determine the camera's blur \(0\.01 ± 0\.02 px\)"):
        start(fit_camera=True)
    assert len(start().corrected) == 1


def test_nothing_to_fit_a_camera_to(tmp_path, here):
    (tmp_path / "short.binary").write_bytes(b"short")
    with pytest.raises(FitError, match="no table can be read"):
        correct_all([tmp_path], rigs.merl(), tmp_path / "out", fit_camera=True, corrector=simple.records_lens)
