"""A whole capture of a sphere as a camera would have taken it, with its truth: noiseless pictures of sphere_picture.py, then
gains, exposures, Poisson and read noise, a full well, whole numbers.

Imports nothing of the package. All exposures of one lamp position share its gain and its shift; the next position has others.
What is stated (nominal times, lamp table, distances) is wrong by what `Faults` says; the truth is in `Drawn.truth`.
"""

import csv
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tests.oracle.sphere_picture import Surface, View, backlit, direction, lamp_angle, picture

MOSAICS = {"RGGB": ((0, 1), (1, 2)), "BGGR": ((2, 1), (1, 0)), "GRBG": ((1, 0), (2, 1)), "GBRG": ((1, 2), (0, 1))}
METALS = {  # n and k about 610, 550, 465 nm, rounded: only their size matters here
    "Cr": ((3.17, 3.18, 2.38), (3.32, 3.33, 3.14)),
    "Au": ((0.22, 0.42, 1.33), (3.09, 2.35, 1.83)),
    "glass": ((1.5,), (0.0,)),
}


class Sensor(NamedTuple):
    """full well, e-; gain, DN per e-; read noise, e-; black level, DN; bits of the converter; sensitivity of the channels, no
    unit. cfa None: grey. clip "well": the charge is limited before read noise; "converter": the code is. prnu:
    relative scatter of the pixels' sensitivity; vignetting: loss of light in the corners."""

    full_well: float = 30000.0
    gain: float = 0.5
    read_noise: float = 3.0
    black: float = 256.0
    bits: int = 14
    cfa: str | None = "RGGB"
    sensitivity: tuple = (0.6, 1.0, 0.7)
    clip: str = "well"
    prnu: float = 0.0
    vignetting: float = 0.0


class Faults(NamedTuple):
    """Standard deviations: lamp table, rad; shift of a lamp position, px; gain of a lamp position, relative; true over
    nominal exposure time, relative. shift_within: of the frames inside one lamp position, px. between: change of the lamp's
    light between two frames of one lamp position where the reference has frames of its own, relative. table: what a stated
    direction lies off besides, rad, without being stated. outline: by how much the outline frames show too large a radius,
    px."""

    lamps: float = np.radians(0.3)
    shift: float = 0.2
    gain: float = 0.005
    exposure: float = 0.05
    shift_within: float = 0.0
    table: float = 0.0
    outline: float = 0.0
    between: float = 0.0


class Patch(NamedTuple):
    """A white patch beside the sphere. depth: before the sphere's centre, towards the camera, radii; tilt: x and y of its
    normal over z. *_std: of what is stated of each; the tilt's is stated, but not its value."""

    reflectance: float = 0.98
    reflectance_std: float = 0.003
    depth: float = 0.1
    depth_std: float = 0.02
    tilt: tuple = (0.003, -0.003)
    tilt_std: float = np.radians(0.3)


@dataclass
class Drawn:
    """frames: file -> DN (height, width), uint16. rows: of frames.csv. settings: of capture.toml. profile: camera.json.
    truth: everything that a reconstruction is judged by."""

    frames: dict = field(default_factory=dict)
    rows: list = field(default_factory=list)
    settings: dict = field(default_factory=dict)
    profile: dict = field(default_factory=dict)
    truth: dict = field(default_factory=dict)

    def write(self, folder):
        """Write the folder in the capture format (docs/capture.md), and truth.json in it."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        for name, values in self.frames.items():
            (folder / name).parent.mkdir(exist_ok=True)
            write_tiff(folder / name, values)
        with (folder / "frames.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, ["file", "lamp", "angle_deg", "azimuth_deg", "exposure", "time_s"])
            writer.writeheader()
            writer.writerows(self.rows)
        (folder / "capture.toml").write_text(as_toml(self.settings), encoding="utf-8")
        (folder / "camera.json").write_text(json.dumps(self.profile, indent=1), encoding="utf-8")
        (folder / "truth.json").write_text(json.dumps(self.truth, indent=1, default=_listed), encoding="utf-8")
        return folder


def draw(
    surface=None,
    view=None,
    theta_d=None,
    *,
    azimuth=0.0,
    exposures=5,
    step=4.0,
    peak_fill=0.8,
    sensor=None,
    faults=None,
    seed=0,
    darks=2,
    outlines=1,
    backlight=0.05,
    reference="monitor",
    lens_std=0.03,
    distance_std=(0.005, 0.005),
    motion="arc",
    fine=1,
    patch=None,
    flats=0,
    apart=0,
    second=None,
):
    """Draw a capture.

    theta_d: of the lamp positions at the mirror point, rad; default: 18 from 5 to 82 degrees. azimuth: of the arc, rad, or one
    for each lamp. step: between exposures. peak_fill: the brightest pixel of all in the shortest exposure, in full wells: above
    1 it is clipped. darks: of each exposure. flats: of an even field. backlight: rad by which it reaches beyond the limb.
    reference: "monitor" (its light does not depend on where the lamp is), "diffuse" (a white patch that faces the camera,
    `patch`) or None. apart: how many pictures of its own the reference has at each lamp position, in the middle exposure: the
    sample's then show nothing of it, and it stands where the sphere did; 0: it is in the sample's frames. second: share of
    another surface that the sphere shows besides, and that surface.
    """
    surface, view = surface or Surface(), view or View()
    sensor, faults = sensor or Sensor(), faults or Faults()
    rng = np.random.default_rng(seed)
    theta_d = np.radians(np.linspace(5, 82, 18)) if theta_d is None else np.asarray(theta_d, float)
    azimuths = np.broadcast_to(np.asarray(azimuth, float), theta_d.shape)
    angles = np.array([lamp_angle(t, view) for t in theta_d])
    shifts = faults.shift * rng.standard_normal((len(angles), 2))
    gains = np.exp(faults.gain * rng.standard_normal(len(angles)))
    table = angles + faults.lamps * rng.standard_normal(len(angles))
    table_azimuth = azimuths + faults.lamps * rng.standard_normal(len(angles)) / np.maximum(np.sin(angles), 0.05)
    if faults.table:
        table = table + faults.table * rng.standard_normal(len(angles))
    names = [f"L{i:02d}" for i in range(len(angles))]
    channel = _channels(view.shape, sensor)
    pattern = _Reference(reference, view, patch or Patch(), apart > 0)
    even = response(view.shape, sensor, seed)
    sensitivity = np.asarray(sensor.sensitivity if sensor.cfa else (1.0,))
    relative = step ** np.arange(exposures)
    nominal = relative / 1000 * np.exp(faults.exposure * rng.standard_normal(exposures))
    ids = [f"E{k}" for k in range(exposures)]
    # noiseless, (lamps, height, width): what each pixel sees of its own colour
    seen = []
    for angle, at, shift in zip(angles, azimuths, shifts, strict=True):
        colours = picture(surface, view, direction(angle, at), shift, fine)
        if second is not None:
            share, other = second
            colours = (1 - share) * colours + share * picture(other, view, direction(angle, at), shift, fine)
        seen.append(_of_channel(colours, channel) * sensitivity[channel])
    scale = peak_fill * sensor.full_well / max((g * s).max() for g, s in zip(gains, seen, strict=True))
    drawn = Drawn()
    for name, clean, gain, angle, said, turned, at in zip(
        names, seen, gains, angles, table, table_azimuth, azimuths, strict=True
    ):
        for k, (exposure, ratio) in enumerate(zip(ids, relative, strict=True)):
            light = clean
            if faults.shift_within:
                light = _moved(clean, faults.shift_within * rng.standard_normal(2))
            electrons = scale * ratio * gain * light
            if apart:
                pass
            elif reference == "diffuse":
                pattern.add_patch(electrons, scale * ratio * gain, direction(angle, at), view, sensitivity[channel])
            else:
                pattern.add(electrons, ratio / relative[-1] * gain, 0.6 * sensor.full_well)
            file = f"frames/{name}_{exposure}.tif"
            drawn.frames[file] = _expose(electrons * even, sensor, rng)
            drawn.rows.append(_row(file, name, np.degrees(said), np.degrees(turned), exposure, nominal[k]))
    middle = exposures // 2
    for name, gain, angle, at in zip(names, gains, angles, azimuths, strict=True):
        moments = faults.between / np.sqrt(2) * rng.standard_normal(apart + 1) if apart else ()
        for i in range(apart):  # the first moment is that of the sample's frames
            own = gain * np.exp(moments[i + 1] - moments[0])
            electrons, ratio = np.zeros(view.shape), relative[middle]
            if reference == "diffuse":
                pattern.add_patch(electrons, scale * ratio * own, direction(angle, at), view, sensitivity[channel])
            else:
                pattern.add(electrons, 0.7 * own, 0.6 * sensor.full_well)
            file = f"reference/{name}_{i}.tif"
            drawn.frames[file] = _expose(electrons * even, sensor, rng)
            drawn.rows.append(_row(file, name, None, None, ids[middle], nominal[middle]))
    for k, exposure in enumerate(ids):
        for i in range(darks):
            file = f"dark/D{i}_{exposure}.tif"
            drawn.frames[file] = _expose(np.zeros(view.shape), sensor, rng)
            drawn.rows.append(_row(file, "", None, None, exposure, nominal[k]))
    for i in range(outlines):
        bright = backlit(view._replace(radius=view.radius + faults.outline), backlight, surface)
        file = f"outline/O{i}.tif"
        drawn.frames[file] = _expose(0.6 * sensor.full_well * bright * sensitivity[channel] * even, sensor, rng)
        drawn.rows.append(_row(file, "", None, None, ids[0], nominal[0]))
    for i in range(flats):
        file = f"flat/F{i}.tif"
        drawn.frames[file] = _expose(0.6 * sensor.full_well * sensitivity[channel] * even, sensor, rng)
        drawn.rows.append(_row(file, "", None, None, ids[-1], nominal[-1]))
    sigma_said = view.sigma * np.exp(lens_std * rng.standard_normal()) if lens_std else view.sigma
    distances = [
        d * (1 + s * rng.standard_normal()) for d, s in zip((view.camera, view.lamp), distance_std, strict=True)
    ]
    drawn.profile = _profile(sigma_said, lens_std, view, sensor)
    drawn.settings = _settings(view, sensor, faults, distances, distance_std, pattern, motion)
    if reference == "diffuse":
        drawn.settings["reference"] |= _stated_patch(pattern.patch, rng)
    drawn.truth = {
        "surface": surface._asdict(),
        "view": view._asdict(),
        "sensor": sensor._asdict(),
        "lamps": [
            {"lamp": n, "direction": direction(a, z), "angle_deg": np.degrees(a), "azimuth_deg": np.degrees(z),
             "theta_d_deg": np.degrees(t), "gain": g, "shift_px": s}
            for n, a, z, t, g, s in zip(names, angles, azimuths, theta_d, gains, shifts, strict=True)
        ],
        "exposures": [{"exposure": e, "nominal_s": t, "relative": r} for e, t, r in zip(ids, nominal, relative, strict=True)],
        "electrons_per_radiance": scale,
        "clip_dn": min(sensor.full_well * sensor.gain + sensor.black, 2.0**sensor.bits - 1),
        "gain_dn_per_electron": sensor.gain,
        "backlight_rad": backlight,
        "patch": pattern.patch._asdict() if reference == "diffuse" else None,
        "centre_px": [view.column, view.row],
        "radius_px": view.radius,
    }  # fmt: skip
    return drawn


def noiseless(drawn, lamp, surface=None, fine=1):
    """Electrons that every pixel of a lamp position expects in exposure "E0" (the shortest), without the reference."""
    view = View(**drawn.truth["view"])
    sensor = Sensor(**drawn.truth["sensor"])
    surface = surface or Surface(**drawn.truth["surface"])
    one = next(item for item in drawn.truth["lamps"] if item["lamp"] == lamp)
    channel = _channels(view.shape, sensor)
    sensitivity = np.asarray(sensor.sensitivity if sensor.cfa else (1.0,))
    colours = picture(surface, view, np.asarray(one["direction"]), one["shift_px"], fine)
    return drawn.truth["electrons_per_radiance"] * one["gain"] * _of_channel(colours, channel) * sensitivity[channel]


def response(shape, sensor, seed):
    """Relative response of every pixel: its own sensitivity, and light that falls off from the middle as the radius squared."""
    scatter = np.random.default_rng(seed + 10_000).standard_normal(shape)
    y, x = (np.linspace(-1, 1, n) for n in shape)
    return (1 + sensor.prnu * scatter) * (1 - sensor.vignetting * (x[None] ** 2 + y[:, None] ** 2) / 2)


class _Reference:
    """A square of 40 px in the first corner; in pictures of its own, one in the middle."""

    def __init__(self, kind, view, patch, apart=False):
        self.kind, self.patch, self.apart = kind, patch, apart
        self.region = (8, 8, 40, 40)  # column, row, width, height
        if apart:
            self.region = (int(view.column) - 20, int(view.row) - 20, 40, 40)
        assert apart or kind is None or view.column + view.row - 96 > np.sqrt(2) * (view.radius + 4), (
            "the reference is on the sphere"
        )

    def add(self, electrons, exposure, level):
        if self.kind is None:
            return
        column, row, width, height = self.region
        electrons[row : row + height, column : column + width] = level * exposure

    def add_patch(self, electrons, exposure, towards, view, sensitivity):
        """Lambert's law in every pixel: reflectance / pi times the irradiance at that point of the patch."""
        column, row, width, height = self.region
        x, y = np.meshgrid(np.arange(column, column + width) - view.column, view.row - np.arange(row, row + height))
        focal = view.radius * np.sqrt(view.camera**2 - 1)
        shrink = (view.camera - self.patch.depth) / focal
        position = np.stack([x * shrink, y * shrink, np.full(x.shape, self.patch.depth)], -1)
        way = view.lamp * towards - position  # radii
        far = np.sqrt((way**2).sum(-1))
        normal = np.array([*self.patch.tilt, 1.0])
        cosine = np.maximum(way @ (normal / np.linalg.norm(normal)) / far, 0)
        radiance = self.patch.reflectance / np.pi * cosine * (view.lamp / far) ** 2
        here = np.s_[row : row + height, column : column + width]
        electrons[here] = exposure * radiance * sensitivity[here]


def _channels(shape, sensor):
    if not sensor.cfa:
        return np.zeros(shape, int)
    tile = np.array(MOSAICS[sensor.cfa])
    return np.tile(tile, (shape[0] // 2 + 1, shape[1] // 2 + 1))[: shape[0], : shape[1]]


def _of_channel(colours, channel):
    channel = np.minimum(channel, colours.shape[2] - 1)
    return np.take_along_axis(colours, channel[..., None], axis=2)[..., 0]


def _moved(clean, shift):
    from scipy.ndimage import shift as moved

    return np.maximum(moved(clean, (shift[1], shift[0]), order=3), 0)


def _expose(electrons, sensor, rng):
    # Poisson of millions is a waste where the well is full anyway
    charge = rng.poisson(np.minimum(electrons, 2 * sensor.full_well + 100)).astype(float)
    if sensor.clip == "well":
        charge = np.minimum(charge, sensor.full_well)
    code = sensor.gain * (charge + sensor.read_noise * rng.standard_normal(charge.shape)) + sensor.black
    top = 2**sensor.bits - 1
    if sensor.clip == "converter":
        top = min(top, int(sensor.full_well * sensor.gain + sensor.black))
    return np.clip(np.round(code), 0, top).astype(np.uint16)


def _row(file, lamp, angle, azimuth, exposure, time):
    angle, azimuth = ("" if v is None else f"{v:.4f}" for v in (angle, azimuth))
    return {
        "file": file,
        "lamp": lamp,
        "angle_deg": angle,
        "azimuth_deg": azimuth,
        "exposure": exposure,
        "time_s": f"{time:.8g}",
    }


def _profile(sigma, lens_std, view, sensor):
    return {
        "format": "matcam camera profile",
        "version": 2,
        "optics": {"model": "gaussian", "sigma_px": sigma},
        "pixel": {"model": "box", "half_width_px": view.half_width},
        "sensor": {
            "pitch_m": 5e-6, "full_well_electrons": sensor.full_well, "read_noise_electrons": sensor.read_noise,
            "gain_dn_per_electron": sensor.gain, "bits": sensor.bits, "cfa": sensor.cfa, "prnu": 0.0,
            "dark_current_electrons_per_s": 0.0, "dark_nonuniformity": 0.0, "black_level_dn": sensor.black, "pattern_seed": 0,
        },
        "uncertainty": {"parameters": ["optics.sigma_px"], "covariance": [[(lens_std * sigma) ** 2]]},
        "provenance": {"source": "synthetic", "created": "2026-01-01", "software": "an oracle", "notes": ""},
    }  # fmt: skip


def _settings(view, sensor, faults, distances, distance_std, pattern, motion):
    radius = 25.0
    settings = {
        "format": "matcam capture",
        "version": 1,
        "camera": {"profile": "camera.json"} | ({"cfa": sensor.cfa} if sensor.cfa else {}),
        "sample": {"kind": "sphere", "radius_mm": [radius, 0.005]},
        "distances": {
            "camera_mm": [radius * distances[0], radius * view.camera * distance_std[0]],
            "lamp_mm": [radius * distances[1], radius * view.lamp * distance_std[1]],
        },
        "lamp": {
            "radius_mm": [0.0, 0.0],
            "motion": motion,
            "direction_std_deg": float(np.degrees(faults.lamps)),
            "intensity": "reference" if pattern.kind else "constant",
            "gain_std": faults.gain,
        },
    }
    if pattern.kind:
        settings["reference"] = {"kind": pattern.kind, "region_px": list(pattern.region)}
        if pattern.apart:
            settings["reference"]["apart"] = True
    return settings


def _stated_patch(patch, rng, radius=25.0):
    return {
        "reflectance": [patch.reflectance + patch.reflectance_std * rng.standard_normal(), patch.reflectance_std],
        "depth_mm": [radius * (patch.depth + patch.depth_std * rng.standard_normal()), radius * patch.depth_std],
        "tilt_std_deg": float(np.degrees(patch.tilt_std)),
    }


def _listed(value):
    return value.tolist()


def as_toml(settings):
    """Write tables of plain values as TOML."""
    top = [f"{key} = {json.dumps(value)}" for key, value in settings.items() if not isinstance(value, dict)]
    for name, table in settings.items():
        if isinstance(table, dict):
            top += ["", f"[{name}]", *(f"{key} = {json.dumps(value)}" for key, value in table.items())]
    return "\n".join(top) + "\n"


def write_tiff(path, values):
    """Write a picture as TIFF 6.0: one strip, uncompressed, little-endian, 16 bits."""
    import struct

    height, width = values.shape[:2]
    channels = values.shape[2] if values.ndim == 3 else 1
    bits = 8 * values.dtype.itemsize
    data = np.ascontiguousarray(values, values.dtype.newbyteorder("<")).tobytes()
    # tag, type (3: 16 bits, 4: 32 bits), value
    entries = [
        (256, 4, width), (257, 4, height), (258, 3, bits), (259, 3, 1), (262, 3, 1 if channels == 1 else 2), (273, 4, 8),
        (277, 3, channels), (278, 4, height), (279, 4, len(data)), (284, 3, 1),
    ]  # fmt: skip
    after = b""
    if channels > 1:
        offset = 8 + len(data) + 2 + 12 * len(entries) + 4
        after = struct.pack(f"<{channels}H", *[bits] * channels)
        entries[2] = (258, 3, offset)
    with Path(path).open("wb") as file:
        file.write(b"II*\0" + struct.pack("<I", 8 + len(data)) + data + struct.pack("<H", len(entries)))
        for tag, kind, value in entries:
            count = channels if tag == 258 else 1
            file.write(struct.pack("<HHI", tag, kind, count))
            file.write(
                struct.pack("<I", value) if kind == 4 or (tag == 258 and channels > 1) else struct.pack("<HH", value, 0)
            )
        file.write(struct.pack("<I", 0) + after)
