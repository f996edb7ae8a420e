"""RGL files of at most 1 MB of 25 stand-ins of MERL's materials: size, and error at random pairs and at the peak by Mitsuba.

Usage: bench_compact.py. Every fourth of the stand-ins of benchmarks/stand_ins.json, whose factors lie in shared/ beside the
checkout. The smallest grid that reaches 1 % is taken, or the largest one below 1 MB. About 8 s of a core for each.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import mitsuba as mi
import numpy as np

from matcam import read_merl
from matcam.exchange.conversion import resampling_error
from matcam.exchange.parameterisation import GRID_SIZES, resampled_grid
from matcam.io import write_rgl
from matcam.material import Adaptive, Tabulated
from results import record

ROOT = Path(__file__).resolve().parents[1]
TOOL = ROOT.parent / "shared" / "tools" / "npf_to_merl.py"
ERROR, LARGEST = 0.01, 1e6
_SMALL = 5
"""Number of grids, the smallest first, that can keep a file below 1 MB."""
ANGLES = np.radians(np.arange(0.25, 45, 0.5))


def peak_error(path: Path, table: Tabulated) -> float:
    """Median relative error of the peak that Mitsuba evaluates, over mirror directions up to 45 degrees."""
    bsdf = mi.load_dict({"type": "measured", "filename": str(path)})
    found = []
    for theta in ANGLES:
        interaction = mi.SurfaceInteraction3f()
        interaction.wi = mi.Vector3f(np.sin(theta), 0, np.cos(theta))
        seen = np.array(bsdf.eval(mi.BSDFContext(), interaction, mi.Vector3f(-np.sin(theta), 0, np.cos(theta))))
        truth = np.asarray(table.brdf(0.0, theta, np.pi / 2))
        found.append(np.max(np.abs(seen / np.cos(theta) / truth - 1)))
    return float(np.nanmedian(found))


def compact(name: str, folder: Path) -> tuple[float, float, float]:
    """Make the RGL file of a stand-in; size, MB, median error at random pairs, error of the peak."""
    subprocess.run([sys.executable, TOOL, name, folder / "a.binary"], check=True)
    table = Tabulated(read_merl(folder / "a.binary"))
    best = (np.nan, np.inf, np.inf)
    for size in GRID_SIZES[:_SMALL]:
        fields = resampled_grid(table, size, peak_error=ERROR)
        write_rgl(folder / "a.bsdf", fields, force=True)
        taken = (folder / "a.bsdf").stat().st_size
        if taken > LARGEST:
            continue
        median = resampling_error(table, Adaptive(fields))["median"]
        if median < best[1]:
            best = taken / 1e6, median, peak_error(folder / "a.bsdf", table)
        if max(best[1:]) <= ERROR:
            break
    return best


def main() -> None:
    mi.set_variant("scalar_rgb")
    names = list(json.loads((ROOT / "benchmarks" / "stand_ins.json").read_text(encoding="utf-8")))[::4]
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            rows.append(compact(name, Path(folder)))
            print(f"{name}: {rows[-1][0]:.2f} MB, median {rows[-1][1]:.2%}, peak {rows[-1][2]:.2%}", flush=True)
    size, median, peak = np.array(rows).T
    record(
        "bench_compact.py",
        [
            ("RGL files of stand-ins: largest size", "≤ 1 MB", f"{size.max():.2f} MB of {len(names)}"),
            (
                "RGL files below 1 MB: peak by Mitsuba within 1 %",
                "all",
                f"{(peak <= ERROR).sum()} of {len(names)}, the worst {peak.max():.2%}",
            ),
            (
                "RGL files below 1 MB: median at random pairs within 1 %",
                "all",
                f"{(median <= ERROR).sum()} of {len(names)}, the worst {median.max():.1%}"
                + ("" if median.max() <= ERROR else ": not met"),
            ),
        ],
    )


if __name__ == "__main__":
    main()
