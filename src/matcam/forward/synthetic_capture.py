"""Synthetic capture of a known material: exposure series of mosaic frames, dark frames, outline frames and a reference.

A synthetic capture is intended for practice and planning. It is simulated with the forward model of this package, so its
reconstruction tests everything except this model. The specified lamp directions, exposure times, distances and patch
reflectance have realistic errors. The sphere moves slightly between lamp positions, and the intensity of the lamp drifts.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from matcam.camera.camera import Camera
from matcam.camera.optics.optics import checked_isotropic
from matcam.camera.sensor import Sensor
from matcam.core import checks
from matcam.core.errors import ArgumentError, OutputError
from matcam.core.io import check_output_folder, replacing, write_json
from matcam.core.readers.names import is_folder
from matcam.files.capture_writing import write_codes, write_description
from matcam.forward.synthetic_samples import RADIUS_MM, LampErrors, SyntheticSample, synthetic_sample
from matcam.lamp.lamps import NearLamp
from matcam.material.material import Material
from matcam.rigs import Rig
from matcam.sample.shape import Curved

_REFERENCE = (4, 4, 40, 40)
"""Region of the reference in each frame: column, row, width and height, px."""
_FILLED = 0.8
"""Share of the full well in the brightest pixel of the shortest exposure, or of the longest one if pixels must not clip."""
_FIELD = 0.6
"""Share of the full well in the bright field of an outline frame, and in the monitor in the longest exposure."""


class WhitePatch(NamedTuple):
    """White patch that faces the camera beside the sphere, and the errors of its specified properties.

    Attributes:
        reflectance: reflectance, no unit. Default: 0.98.
        reflectance_std: standard deviation of the specified reflectance, no unit. Default: 0.003.
        depth: distance from the centre of the sphere towards the camera, radii. Default: 0.
        depth_std: standard deviation of the specified depth, radii. Default: 0.02.
    """

    reflectance: float = 0.98
    reflectance_std: float = 0.003
    depth: float = 0.0
    depth_std: float = 0.02


class CapturePlan(NamedTuple):
    """Contents of a synthetic capture, and the errors of its specified values.

    Attributes:
        theta_d: difference angle at the highlight for each lamp position, rad, (n,). For a flat sample, only the number n is
            used: the number of tilts.
        azimuth: azimuth of the lamp's arc about the optical axis, rad. Default: 0.
        exposures: number of exposures per lamp position. Default: 5.
        step: ratio of successive exposure times, > 1. Default: 4.
        lamp_std: standard deviation of the specified lamp angles, rad. Default: 0.3 degrees.
        gain_std: relative standard deviation of the lamp's intensity between lamp positions, no unit. Default: 0.005.
        time_std: relative standard deviation of the specified exposure times, no unit. Default: 0.05.
        error: largest allowed error of the simulated images, as a share of their peak (see `picture`), no unit. Default:
            1e-4.
        shift_std: standard deviation of the position of the sphere between lamp positions, along columns and rows, px.
            Default: 0.2.
        distance_std: relative standard deviation of the specified distances of camera and lamp, no unit. Default: 0.005.
        patch: white patch in every frame of a sphere or cylinder; None: the reference is a monitor of the lamp's intensity.
            Default: a typical patch.
        shape: (height, width) of the images of a flat sample, px. Default: None, 256 x 256.
    """

    theta_d: Sequence[float]
    azimuth: float = 0.0
    exposures: int = 5
    step: float = 4.0
    lamp_std: float = math.radians(0.3)
    gain_std: float = 0.005
    time_std: float = 0.05
    error: float = 1e-4
    shift_std: float = 0.2
    distance_std: float = 0.005
    patch: WhitePatch | None = WhitePatch()
    shape: tuple[int, int] | None = None


def simulate_capture(
    material: Material,
    rig: Rig,
    plan: CapturePlan,
    folder: str | Path,
    *,
    seed: int = 0,
    force: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Simulate a capture, and write it with its true parameters (truth.json).

    The sample is a sphere, a cylinder or flat. On a flat sample, textures modulate the diffuse albedo and the specular
    strength of the material. A flat sample is tilted between images under one distant lamp, and its capture has neither
    reference nor outline frames.

    Args:
        material: material of the sample.
        rig: camera with a sensor of at most 16 bits, a sample and a lamp.
        plan: lamp positions, exposures, and errors of specified values.
        folder: output folder; it is created.
        seed: seed of noise and errors. Default: 0.
        force: True to replace existing files. Default: False.
        progress: function that is called with the numbers of finished and of all lamp positions. Default: None.

    Returns:
        True parameters, as in truth.json.

    Raises:
        ArgumentError: `seed` is not a non-negative integer, the rig has no sensor or a sensor of more than 16 bits, the
            sample cannot be simulated, the lens is not isotropic, or a value of the plan is out of range.
        OutputError: `folder` contains files and `force` is False, or a file cannot be written.
    """
    checks.whole_number("seed", seed, 0)
    sensor = _sensor(rig)
    sample = synthetic_sample(rig, plan.shape, seed)
    shape = sample.shape
    checked_isotropic(rig.camera.optics, "a capture, whose outline has edges in all directions,")
    if not 1 <= plan.exposures <= 12 or not plan.step > 1 or not len(plan.theta_d):
        got = f"a theta_d of length {len(plan.theta_d)}, exposures {plan.exposures} and step {plan.step:g}"
        raise ArgumentError(f"plan must have a theta_d of length >= 1, exposures in [1, 12] and step > 1, got {got}")
    folder = Path(folder)
    check_output_folder(folder)
    if _holds_files(folder) and not force:
        raise OutputError(f"output {folder} exists and is not empty: use force=True to write into it")
    rng = np.random.default_rng(seed)
    errors = LampErrors(plan.lamp_std, plan.gain_std, plan.shift_std)
    lamps = list(sample.lamps(np.asarray(plan.theta_d, dtype=float), plan.azimuth, errors, rng))
    pictures = []
    for number, lamp in enumerate(lamps):
        pictures.append(sample.drawn(material, lamp, plan.error))
        if progress:
            progress(number + 1, len(lamps))
    well = float(sensor.full_well)
    scale = _FILLED * well / max(lamp["gain"] * float(p.max()) for lamp, p in zip(lamps, pictures, strict=True))
    relative = plan.step ** np.arange(plan.exposures)
    if not sample.may_clip:
        scale /= relative[-1]
    nominal = relative / 1000 * np.exp(plan.time_std * rng.standard_normal(plan.exposures))
    names = [f"E{k + 1}" for k in range(plan.exposures)]
    rows: list[dict[str, Any]] = []

    def add(file: str, electrons: np.ndarray, exposure: int, lamp: dict[str, Any] | None = None) -> None:
        write_codes(folder / file, _exposed(sensor, electrons, rng), force=force)
        about = {} if lamp is None else {"lamp": lamp["lamp"], "angle_deg": f"{lamp['stated_deg'][0]:.4f}"}
        about |= {} if lamp is None else {"azimuth_deg": f"{lamp['stated_deg'][1]:.4f}"}
        rows.append({"file": file, "exposure": names[exposure], "time_s": f"{nominal[exposure]:.8g}", **about})

    for lamp, radiance in zip(lamps, pictures, strict=True):
        for k, share in enumerate(relative):
            electrons = scale * share * lamp["gain"] * _mosaic(sensor, radiance)
            column, row, width, height = _REFERENCE
            here = np.s_[row : row + height, column : column + width]
            if not isinstance(rig.sample, Curved):
                pass
            elif plan.patch is None:
                electrons[here] = _FIELD * well * share / relative[-1] * lamp["gain"]
            else:
                electrons[here] = scale * share * lamp["gain"] * _patch_radiance(plan.patch, rig, lamp, shape)
            add(f"frames/{lamp['lamp']}_{names[k]}.tif", electrons, k, lamp)
    for k in range(plan.exposures):
        for number in (1, 2):
            add(f"dark/D{number}_{names[k]}.tif", np.zeros(shape), k)
    outline_shifts = plan.shift_std * rng.standard_normal((2, 2))
    for number, shift in enumerate(outline_shifts):
        field = sample.before_field(shift)
        if field is not None:
            add(f"outline/O{number + 1}.tif", _FIELD * well * field, 0)
    settings = _settings(rig, sample, sensor, plan, rng)
    truth = {
        "format": "matcam capture truth",
        "material": repr(material),
        "radius_px": _finite(_of_curved(rig, "radius")),
        "centre_px": [(shape[1] - 1) / 2, (shape[0] - 1) / 2],
        "camera_radii": _finite(_of_curved(rig, "distance")),
        "lamp_radii": _finite(_lamp_distance(rig)),
        "lamps": lamps,
        "outline_shift_px": outline_shifts.tolist(),
        "patch": None if plan.patch is None else plan.patch._asdict(),
        "exposures": [
            {"exposure": n, "relative": float(r), "nominal_s": float(t)}
            for n, r, t in zip(names, relative, nominal, strict=True)
        ],
        "electrons_per_radiance": scale,
        "clip_dn": float(sensor.saturation * sensor.gain + sensor.black_level),
        "gain_dn_per_electron": float(sensor.gain),
        "seed": seed,
    }
    write_description(folder, settings, rows, force=force)
    with replacing(folder / "camera.json", force=force) as temporary:
        temporary.write_text(json.dumps(rig.camera.profile(), indent=2) + "\n", encoding="utf-8")
    write_json(folder / "truth.json", truth, force=force)
    return truth


def sensor_or_usual(rig: Rig) -> Rig:
    """Add a typical sensor to a rig whose camera has none.

    The sensor has a full well of 30,000 electrons, 14 bits and an RGGB mosaic; for a flat sample it has no mosaic.
    """
    camera = rig.camera
    if camera.sensor is not None:
        return rig
    cfa = "RGGB" if isinstance(rig.sample, Curved) else None
    sensor = Sensor(5e-6, full_well=30_000, read_noise=3.0, gain=0.5, bits=14, cfa=cfa, black_level=256)
    whole = Camera(camera.optics, camera.pixel, sensor, uncertainty=camera.uncertainty, provenance=camera.provenance)
    return eqx.tree_at(lambda r: r.camera, rig, whole)


def _holds_files(folder: Path) -> bool:
    """Check whether a folder contains files. Hidden files are ignored, because interrupted runs leave them behind."""
    return any(not is_folder(path) and not path.name.startswith(".") for path in folder.rglob("*"))


def _sensor(rig: Rig) -> Sensor:
    sensor = rig.camera.sensor
    if sensor is None:
        raise ArgumentError("a capture needs a camera with a sensor: Camera(optics, pixel, sensor=Sensor(...))")
    if sensor.bits is None or sensor.bits > 16:
        raise ArgumentError(
            f"a capture needs a sensor with a specified number of bits, at most 16, got bits={sensor.bits}"
        )
    return sensor


def _mosaic(sensor: Sensor, radiance: np.ndarray) -> np.ndarray:
    """Select the radiance in the colour of each pixel, or compute the mean of all channels for a monochrome sensor."""
    if sensor.cfa is None:
        return radiance.mean(2)
    three = np.broadcast_to(radiance, (*radiance.shape[:2], 3)) if radiance.shape[2] == 1 else radiance
    channel = sensor.channel_map(*radiance.shape[:2])
    return np.take_along_axis(three, np.asarray(channel)[..., None], axis=2)[..., 0].copy()


def _exposed(sensor: Sensor, electrons: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Simulate the codes of a mosaic, DN, with noise. electrons: expected number of electrons in each pixel."""
    well = float(sensor.full_well)
    charge = np.minimum(rng.poisson(np.minimum(electrons, 2 * well + 100)), well)
    code = float(sensor.gain) * (charge + float(sensor.read_noise) * rng.standard_normal(charge.shape))
    return np.clip(np.round(code + float(sensor.black_level)), 0, 2 ** int(sensor.bits or 16) - 1)


def _patch_radiance(patch: WhitePatch, rig: Rig, lamp: dict[str, Any], shape: tuple[int, int]) -> np.ndarray:
    """Compute the radiance of a white patch, 1/sr, for unit irradiance at the centre of the sphere (docs/model.md 10)."""
    column, row, width, height = _REFERENCE
    x, y = np.meshgrid(
        np.arange(column, column + width) - (shape[1] - 1) / 2, (shape[0] - 1) / 2 - np.arange(row, row + height)
    )
    q, w = (0.0 if math.isinf(d) else 1 / d for d in (_of_curved(rig, "distance"), _lamp_distance(rig)))
    shrink = (1 - q * patch.depth) / (_of_curved(rig, "radius") * math.sqrt(1 - q**2))
    position = np.stack([x * shrink, y * shrink, np.full(x.shape, patch.depth)], axis=-1)
    way = np.array(lamp["direction"]) - w * position
    irradiance = np.maximum(way[..., 2], 0) / np.linalg.norm(way, axis=-1) ** 3
    return np.asarray(patch.reflectance / math.pi * irradiance)


def _of_curved(rig: Rig, name: str) -> float:
    """Read the radius or the camera distance of a curved sample; infinity for a flat sample. name: name of the attribute."""
    return float(getattr(rig.sample, name, math.inf))


def _lamp_distance(rig: Rig) -> float:
    return float(rig.lamp.distance) if isinstance(rig.lamp, NearLamp) else math.inf


def _finite(value: Any) -> float | None:
    return float(value) if math.isfinite(float(value)) else None


def _settings(
    rig: Rig, sample: SyntheticSample, sensor: Sensor, plan: CapturePlan, rng: np.random.Generator
) -> dict[str, Any]:
    """Build the contents of capture.toml: true values with random errors."""
    spread = plan.distance_std
    distances = {
        "camera_mm": _of_curved(rig, "distance") * (1 + spread * rng.standard_normal()),
        "lamp_mm": _lamp_distance(rig) * (1 + spread * rng.standard_normal()),
    }
    curved = isinstance(rig.sample, Curved)
    reference: dict[str, Any] = {"kind": "monitor", "region_px": list(_REFERENCE)}
    if plan.patch is not None:
        stated = plan.patch.reflectance + plan.patch.reflectance_std * rng.standard_normal()
        depth = plan.patch.depth + plan.patch.depth_std * rng.standard_normal()
        reference |= {
            "kind": "diffuse",
            "reflectance": [float(min(stated, 1.0)), plan.patch.reflectance_std],
            "depth_mm": [RADIUS_MM * depth, RADIUS_MM * plan.patch.depth_std],
            "tilt_std_deg": 0.1,
        }
    return {
        "format": "matcam capture",
        "version": 1,
        "camera": {"profile": "camera.json"} | ({"cfa": sensor.cfa} if sensor.cfa else {}),
        "sample": sample.settings(),
        "distances": {
            name: [RADIUS_MM * d, spread * RADIUS_MM * d] for name, d in distances.items() if math.isfinite(d)
        },
        "lamp": {
            "motion": "arc" if curved else "free",
            "direction_std_deg": max(math.degrees(plan.lamp_std), 0.01),
            "intensity": "reference" if curved else "constant",
            "gain_std": max(plan.gain_std, 1e-4),
        },
        **({"reference": reference} if curved else {}),
        "outline": {"field_beyond_deg": 0.0},
    }
