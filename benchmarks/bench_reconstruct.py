"""Photographs in, material out: processor time and peak memory of every part of `reconstruct`, and a run that is cut off.

    bench_reconstruct.py            18 x 5 frames of 2.7 megapixels (0.5 GB of disk)
    bench_reconstruct.py --full     18 x 5 frames of 24 megapixels (4.9 GB of disk): what is asked for

The capture is drawn with NumPy alone: GGX of a metal, a near lamp and camera, one sample a pixel (its highlight is ten pixels
wide and more), a Gaussian lens, Poisson and read noise.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import tifffile
from scipy.ndimage import gaussian_filter

from results import record

ALPHA, INDEX, CAMERA, LAMP, LENS = 0.03, (3.18, 3.33), 40.0, 25.0, 0.55
WELL, GAIN, READ, BLACK = 30_000, 0.5, 3.0, 256
LAMPS, EXPOSURES, STEP = 18, 5, 4.0
SIZES = {False: (1340, 2010, 335.0), True: (4000, 6000, 1000.0)}  # height, width, radius of the sphere, px


def draw(folder: Path, full: bool) -> None:
    """The capture as files of 16 bits, a mosaic of one colour's light."""
    height, width, radius = SIZES[full]
    rng = np.random.default_rng(1)
    for kind in ("frames", "dark", "outline"):
        (folder / kind).mkdir(parents=True)
    side = int(radius) + 60
    rows, columns = np.indices((2 * side, 2 * side))
    x, y = (columns - side) / radius, (side - rows) / radius
    angles = np.radians(np.linspace(10, 158, LAMPS))
    scenes = [radiance(x, y, radius, angle, 0.3) for angle in angles]
    scale = 0.8 * WELL / max(one.max() for one in scenes)
    noise = rng.normal(BLACK, GAIN * READ, (height + 97, width + 89)).astype(np.float32)  # cut anew for each frame
    lines = ["file,lamp,angle_deg,azimuth_deg,exposure,time_s"]
    top, left = height // 2 - side, width // 2 - side
    patch = np.s_[10:70, 10:70]

    def write(name: str, electrons: np.ndarray | None, monitor: float, field: float = 0.0) -> None:
        down, right = rng.integers(0, [97, 89])
        codes = noise[down : down + height, right : right + width] + np.float32(GAIN * field)
        if electrons is not None:
            charge = np.minimum(electrons + np.sqrt(electrons) * rng.standard_normal(electrons.shape), WELL)
            codes[top : top + 2 * side, left : left + 2 * side] += (GAIN * (charge - field)).astype(np.float32)
        if monitor:
            codes[patch] += GAIN * rng.poisson(monitor, (60, 60))
        tifffile.imwrite(folder / name, np.clip(np.rint(codes), 0, 2**14 - 1).astype(np.uint16))

    for number, (angle, scene) in enumerate(zip(angles, scenes, strict=True)):
        for k in range(EXPOSURES):
            name = f"frames/L{number:02d}_E{k}.tif"
            write(name, np.minimum(scale * STEP**k * scene, 4 * WELL), 0.5 * WELL * STEP ** (k - EXPOSURES + 1))
            lines.append(f"{name},L{number:02d},{np.degrees(angle):.4f},{np.degrees(0.3):.4f},E{k},{STEP**k / 1000:g}")
    for k in range(EXPOSURES):
        for number in range(2):
            write(f"dark/D{number}_E{k}.tif", None, 0.0)
            lines.append(f"dark/D{number}_E{k}.tif,,,,E{k},{STEP**k / 1000:g}")
    beyond = np.clip((np.hypot(x, y) - 1) * radius + 0.5, 0, 1)
    write("outline/O0.tif", 0.6 * WELL * gaussian_filter(beyond, LENS, mode="nearest"), 0.0, 0.6 * WELL)
    lines.append("outline/O0.tif,,,,E0,0.001")
    (folder / "frames.csv").write_text("\n".join(lines) + "\n")
    (folder / "capture.toml").write_text(
        f"""format = "matcam capture"
version = 1
camera = {{profile = "camera.json", cfa = "RGGB"}}
sample = {{kind = "sphere", radius_mm = [25.0, 0.005]}}
distances = {{camera_mm = [{25 * CAMERA}, 5.0], lamp_mm = [{25 * LAMP}, 3.0]}}
lamp = {{motion = "arc", direction_std_deg = 0.3, intensity = "reference"}}
reference = {{kind = "monitor", region_px = [10, 10, 60, 60]}}
outline = {{field_beyond_deg = 0.0}}
"""
    )
    profile = {
        "format": "matcam camera profile",
        "version": 2,
        "optics": {"model": "gaussian", "sigma_px": LENS},
        "pixel": {"model": "box", "half_width_px": 0.05},
        "sensor": None,
        "uncertainty": {"parameters": ["optics.sigma_px"], "covariance": [[(0.03 * LENS) ** 2]]},
        "provenance": {"source": "drawn", "created": "2026-01-01", "software": "bench_reconstruct.py", "notes": ""},
    }
    (folder / "camera.json").write_text(json.dumps(profile))


def radiance(x: np.ndarray, y: np.ndarray, radius: float, angle: float, azimuth: float) -> np.ndarray:
    """Radiance under unit irradiance at the sphere's centre, through the lens (docs/model.md 10)."""
    q = 1 / CAMERA
    stretch = np.sqrt(1 - q**2)
    slope2 = (x**2 + y**2) / stretch**2
    inside = x**2 + y**2 < 1
    n_z = (slope2 * q + np.sqrt(np.maximum(1 - slope2 * (1 - q**2), 0))) / (1 + slope2 * q**2)
    n = np.stack([x / stretch * (1 - q * n_z), y / stretch * (1 - q * n_z), n_z])
    towards = np.array([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)])
    light, view = towards[:, None, None] - n / LAMP, np.array([0, 0, 1.0])[:, None, None] - q * n
    far2 = (light**2).sum(0)
    light, view = light / np.sqrt(far2), view / np.sqrt((view**2).sum(0))
    cos_i, cos_o = (light * n).sum(0), (view * n).sum(0)
    lit = inside & (cos_i > 1e-3) & (cos_o > 1e-3)
    half = light + view
    half /= np.sqrt((half**2).sum(0))
    cos_h, cos_d = (half * n).sum(0), (half * view).sum(0)
    tan2 = np.maximum(1 / np.maximum(cos_h, 1e-6) ** 2 - 1, 0)
    d = ((1 + tan2) * ALPHA / (ALPHA**2 + tan2)) ** 2 / np.pi
    cos_i, cos_o = np.maximum(cos_i, 1e-3), np.maximum(cos_o, 1e-3)
    g = 1 / (1 + sum((np.sqrt(1 + ALPHA**2 * (1 / c**2 - 1)) - 1) / 2 for c in (cos_i, cos_o)))
    eta = INDEX[0] + 1j * INDEX[1]
    below = np.sqrt(eta**2 - (1 - cos_d**2))
    f = (
        np.abs((eta**2 * cos_d - below) / (eta**2 * cos_d + below)) ** 2
        + np.abs((cos_d - below) / (cos_d + below)) ** 2
    ) / 2
    return gaussian_filter(np.where(lit, f * d * g / (4 * cos_o) / far2, 0.0), LENS)


def measure(folder: Path) -> None:
    """Reconstruct in this process; print processor time and peak memory after each part."""
    from matcam.core.jax import use_compilation_cache

    use_compilation_cache()
    from matcam import reconstruct

    parts: dict[str, float] = {}
    last = [time.process_time(), time.perf_counter()]
    walls: dict[str, float] = {}

    def progress(step: str, done: int, total: int) -> None:
        name = step.split(" (")[0]
        now, wall = time.process_time(), time.perf_counter()
        parts[name], walls[name] = parts.get(name, 0.0) + now - last[0], walls.get(name, 0.0) + wall - last[1]
        last[:] = [now, wall]

    found = reconstruct(folder, progress=progress, workers=2)
    progress("table and budget", 1, 1)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    for name, seconds in parts.items():
        print(f"  {name}: {seconds:.1f} s of processor time here ({walls[name]:.1f} s on the clock)")
    print(f"  all: {sum(parts.values()):.1f} s ({sum(walls.values()):.1f} s), peak memory {peak:.2f} GiB")
    quantity = (
        f"{LAMPS} x {EXPOSURES} frames, sphere of {found.geometry['radius_px'][0]:.0f} px, processor time; peak memory"
    )
    record("bench_reconstruct.py", [(quantity, "≤ 5 min; ≤ 4 GB", f"{sum(parts.values()):.0f} s; {peak:.2f} GiB")])
    alpha = found.parameters.get("alpha")
    print(
        f"  alpha {alpha} (true {ALPHA}); unexplained {found.fit.solution.unexplained:.2%}; {len(found.remarks)} remarks"
    )


def main() -> None:
    full = "--full" in sys.argv
    with tempfile.TemporaryDirectory(dir=os.environ.get("TMPDIR", "/tmp")) as folder:
        capture = Path(folder) / "capture"
        # in processes of their own: drawing takes more memory than what is measured
        subprocess.run([sys.executable, __file__, "draw", str(capture), str(int(full))], check=True)
        height, width, radius = SIZES[full]
        print(
            f"{LAMPS} x {EXPOSURES} frames of {width} x {height} px, sphere of {radius:.0f} px (asked for: 5 min, 4 GB)"
        )
        subprocess.run([sys.executable, __file__, "measure", str(capture)], check=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["draw"]:
        draw(Path(sys.argv[2]), bool(int(sys.argv[3])))
    elif sys.argv[1:2] == ["measure"]:
        measure(Path(sys.argv[2]))
    else:
        main()
