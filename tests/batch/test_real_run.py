"""The real work, by the command as a process: whatever the number of workers, the same numbers."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from matcam import read_merl
from matcam.io import read_netcdf

pytestmark = pytest.mark.slow


def corrected(folder, out, workers):
    command = [sys.executable, "-m", "matcam", "correct", folder, "-o", out, "--workers", str(workers), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ, check=False)
    return done.returncode, json.loads(done.stdout)


def test_results_do_not_depend_on_the_workers(stand_in, tmp_path):
    """Two stand-ins and one cut short, by one worker and by two: equal to 1e-10, missing stays missing, exit code 1."""
    database = tmp_path / "in"
    database.mkdir()
    for material in ("gold-metallic-paint", "nickel"):
        (database / f"{material}.binary").hardlink_to(stand_in(material))
    (database / "short.binary").write_bytes(stand_in("nickel").read_bytes()[:1000])
    worst = 0.0
    for workers in (1, 2):
        code, said = corrected(database, tmp_path / f"out{workers}", workers)
        assert code == 1
        assert len(said["corrected"]) == 2
        assert "short.binary: the file is truncated" in said["failed"][0]["reason"]
    for material in ("gold-metallic-paint", "nickel"):
        one, two = (read_netcdf(tmp_path / f"out{workers}" / f"{material}.nc") for workers in (1, 2))
        for name in ("brdf", "brdf_std", "response"):
            a, b = one[name].values, two[name].values
            np.testing.assert_array_equal(np.isnan(a), np.isnan(b))
            worst = max(worst, np.nanmax(np.abs(a - b) / np.maximum(np.abs(a), 1e-300), initial=0))
        np.testing.assert_array_equal(one["supported"].values, two["supported"].values)
        raw = read_merl(database / f"{material}.binary")
        np.testing.assert_array_equal(np.isnan(raw.values), np.isnan(one["brdf"].values))
        record = json.loads((tmp_path / "out1" / f"{material}.json").read_text())
        print(f"{material}: {record['run']['seconds']:.1f} s, {record['verdict']}")
    print(f"largest relative difference {worst:.1e}")
    assert worst < 1e-10
    page = (tmp_path / "out2" / "index.html").read_text()
    assert page.count("<img ") == 2
    assert "nickel.html" in page
