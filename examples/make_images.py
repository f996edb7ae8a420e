"""Draw the figures of docs/images that show what commands of matcam write.

Run it in the root of the sources: `PYTHONPATH=. python examples/make_images.py [NAME ...]`. Without names, all are drawn.
`overview.png` has its own script, `examples/make_overview.py`, and `stand-ins.png` is drawn by `benchmarks/stand_ins.py`.
"""

import json
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from tests.oracle.chart_camera import ChartCamera

import matcam
from matcam.cli import _run
from matcam.figures.calibration import edge_figure, targets_figure
from matcam.figures.pages import lobe_figure
from matcam.figures.style import save

IMAGES = Path(__file__).parents[1] / "docs" / "images"


def command(line: str) -> None:
    """Run a command of matcam in the current folder."""
    assert _run(line.split()) == 0, line


def predicted_loss(target: Path, folder: Path) -> None:
    """Figure of the first command of docs/howto/plan-a-rig.md."""
    command(f"predict 0.001 0.005 0.02 --radius 400 -o {target} --force")


def demo(target: Path, folder: Path) -> None:
    """Figure of `matcam demo`."""
    if not (folder / "demo").exists():
        command(f"demo --output {folder / 'demo'}")
    shutil.copy(folder / "demo" / target.name, target)


def chart(target: Path, folder: Path) -> None:
    """Page with all targets except sines and lines."""
    command(f"chart --pixels 1200 --dpi 100 -o {folder / 'chart.png'} --force")
    shutil.copy(folder / "chart.png", target)


def corrected_lobe(target: Path, folder: Path) -> None:
    """Correction of GGX 0.002 on the MERL rig, recorded with 1 % noise."""
    rig = matcam.rigs.merl()
    chromium = matcam.Microfacet(matcam.GGX(0.002), matcam.Conductor.from_metal("Cr", [610e-9, 550e-9, 465e-9]))
    noise = matcam.camera.PixelNoise(0.01, 3e-6)  # 1 % of the value, and a part of the peak of the image
    recorded = matcam.forward.with_pixel_noise(matcam.measure(chromium, rig), rig, noise, 1)
    save(lobe_figure(recorded, matcam.inverse.Correction.of(recorded, rig)), target, force=True)


def edge(target: Path, folder: Path) -> None:
    """Edge through a lens with 3 % of glare."""
    camera = matcam.Camera(matcam.HaloOptics(matcam.GaussianOptics(0.5), 0.03, 8.0), matcam.BoxPixel(0.5))
    angle = np.radians(5)
    y, x = np.mgrid[:160, :80]
    distance = (x - 40) * np.cos(angle) + (y - 80) * np.sin(angle)
    light = 0.05 + 0.8 * np.asarray(camera.esf(distance, angle))
    photograph = light + np.random.default_rng(1).normal(0, 0.008, light.shape)
    found = matcam.edge_mtf(photograph, tone="linear")
    save(edge_figure(found, photograph, None, "edge.tif"), target, force=True)


def targets(target: Path, folder: Path) -> None:
    """One photograph of a chart at SNR 60, with perspective, 2 % distortion and 30 % vignetting."""
    design = matcam.targets.design_chart(("sines", "star", "dots"), pixels_across=1400)
    matcam.targets.write_chart(folder / "targets.json", design)
    page = json.loads((folder / "targets.json").read_text())
    camera = ChartCamera(
        page=tuple(page["page_mm"]), width=1600, height=1140, tilt=(0.05, 0.03), roll=0.02, distortion=0.02,
        vignetting=0.3, sigma=0.5,
    )  # fmt: skip
    photograph = camera.photograph(camera.expected(page), 60, 1)
    found = matcam.targets.measure_targets(photograph, design, half_width=0.5)
    truth = matcam.Camera(matcam.GaussianOptics(0.5), matcam.BoxPixel(0.5))
    save(targets_figure(found.samples, truth, "one photograph, SNR 60"), target, force=True)


def render(target: Path, folder: Path) -> None:
    """Gold, and its record by a camera with sigma 1 px on a sphere of 32 px."""
    gold = matcam.Microfacet(matcam.GGX(0.02), matcam.Conductor.from_metal("Au", [610e-9, 550e-9, 465e-9]))
    rig = matcam.Rig(matcam.Camera(matcam.GaussianOptics(1.0), matcam.BoxPixel(0.5)), matcam.Sphere(32.0))
    matcam.write_merl(folder / "gold.binary", matcam.forward.true_table(gold), force=True)
    matcam.write_merl(folder / "gold-recorded.binary", matcam.measure(gold, rig), force=True)
    command(f"render {folder / 'gold.binary'} {folder / 'gold-recorded.binary'} -o {target} --force")


DRAWN: dict[str, Callable[[Path, Path], None]] = {
    "predicted-loss.png": predicted_loss,
    "chromium-fresnel.png": demo,
    "figure-5.png": demo,
    "chart.png": chart,
    "corrected-lobe.png": corrected_lobe,
    "edge.png": edge,
    "targets.png": targets,
    "render.png": render,
}


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch:
        for name in sys.argv[1:] or DRAWN:
            DRAWN[name](IMAGES / name, Path(scratch))
            print(IMAGES / name)
    for left in ("predicted-loss.csv",):  # tables that commands write beside a figure
        (IMAGES / left).unlink(missing_ok=True)
