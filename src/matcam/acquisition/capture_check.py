"""What is wrong with a capture, while one is still in the lab: clipping, gaps, wrong times, a drifting lamp, a moved sample.

It reads a few lamp positions whole and of the others one frame: seconds, not the whole measurement.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from matcam.acquisition.light.reference_patch import ReferencePatch, patch_geometry
from matcam.acquisition.limb.given_outline import mask_outline
from matcam.acquisition.merging import bracket_misfit, merge_position, misfit_remark
from matcam.acquisition.mirror_ball import MirrorBall
from matcam.acquisition.mosaic_frames import MosaicReader
from matcam.acquisition.outline import Sighting
from matcam.acquisition.radiometry import Radiometry, capture_camera, measure_radiometry
from matcam.core.errors import FileFormatError, MatcamError
from matcam.core.remark import Remark
from matcam.files.capture import Capture, Stated
from matcam.files.capture_frames import CaptureFrame, LampGuess

GUESSED_LENS = Stated(0.5, 0.35)
"""px; standard deviation of the blur that is assumed of a lens without a profile, and its error: two of them span lenses of up
to 1.2 px."""
BY_SHAPE = 0.01
"""Unexplained share of the light from which the blurs of lens and lobe, which differ in shape only, are not separated by it."""
_EVEN = 0.05
"""Share of the pixels at the largest code from which a field may be clipped; noise puts a few pixels of a frame there."""
_WHOLE = 4
"""Lamp positions of which all exposures are read."""
_FIRST, _LAST, _GAP = 10.0, 70.0, 12.0
"""Degrees of theta_d: a capture should begin below, end above, and have no larger gap."""
_MOVED = 1.0  # px
_OFF = 4.0  # px, and scatters, by which a highlight is off
HARMLESS = frozenset({"clip-by-pile-up", "clip-not-seen", "gain-stated", "processed", "times-missing"})
"""Remarks that a capture may have and still be found good."""


@dataclass(frozen=True)
class CaptureCheck:
    """Hold what was found in a capture.

    Attributes:
        findings: what should be mended, each naming its frame or lamp position; empty: nothing was found.
        notes: what a reader should know, though it is no fault.
        radiometry: of the lamp positions that were read whole; None: it could not be measured.
        highlights: place of each lamp position's highlight, (column, row) px.
        centre: (column, row) px and radius, px, of the sphere that the highlights and stated directions want; NaN: too few.
    """

    findings: tuple[Remark, ...]
    notes: tuple[Remark, ...]
    radiometry: Radiometry | None
    highlights: dict[str, tuple[float, float]]
    centre: tuple[float, float, float]


def check_capture(capture: Capture) -> CaptureCheck:
    """Check a capture without measuring it whole.

    Args:
        capture: as from `read_capture`.

    Returns:
        What was found. Bad frames are findings, not errors.
    """
    found: list[Remark] = []
    names = list(capture.lamps)
    chosen = [names[i] for i in np.unique(np.linspace(0, len(names) - 1, min(_WHOLE, len(names))).round().astype(int))]
    radiometry = None
    try:
        radiometry = measure_radiometry(capture, lamps=chosen)
        found += radiometry.remarks
    except MatcamError as error:
        found += [*capture.problems, Remark("no-radiometry", str(error))]
    try:
        if capture_camera(capture) is None:
            found.append(Remark("no-profile", f"capture.toml states no camera.profile: {unmeasured_lens()}"))
    except MatcamError as error:
        found.append(Remark("bad-profile", str(error)))
    found += coverage_remarks(capture.lamps)
    found += _outline_remarks(capture)
    if radiometry is not None:
        for lamp in radiometry.used:
            misfit = bracket_misfit(capture, lamp, radiometry, merge_position(capture, lamp, radiometry))
            remark = misfit_remark(lamp, misfit)
            if remark is not None:
                found.append(remark)
    highlights, missing = find_highlights(capture, radiometry)
    found += missing
    centre, off = table_remarks(capture.lamps, highlights, capture)
    found += off
    found += _lamp_remarks(capture, radiometry, centre)
    unique = list(dict.fromkeys(found))
    return CaptureCheck(
        tuple(one for one in unique if one.code not in HARMLESS),
        tuple(one for one in unique if one.code in HARMLESS),
        radiometry,
        highlights,
        centre,
    )


def unmeasured_lens() -> str:
    """Return in words what a reconstruction does about a lens without a profile."""
    return (
        f"the lens is taken as {GUESSED_LENS.value:g} +- {GUESSED_LENS.std:g} px and fitted; where no lobe explains the "
        f"pictures to {BY_SHAPE:.0%}, it keeps this error, and the roughness gets it"
    )


def coverage_remarks(lamps: dict[str, LampGuess]) -> list[Remark]:
    """Return which angles the lamp positions leave out.

    Args:
        lamps: where they are stated to be. Without angles nothing is said.
    """
    angles = np.array([guess.angle for guess in lamps.values()])
    if np.isnan(angles).any() or not angles.size:
        return []
    theta_d = np.sort(np.degrees(angles) / 2)
    found = []
    if theta_d[0] > _FIRST:
        found.append(
            Remark(
                "angles-missed",
                f"no lamp position has theta_d below {theta_d[0]:.0f} degrees: add one below {_FIRST:.0f}",
            )
        )
    if theta_d[-1] < _LAST:
        text = f"the lamp positions end at theta_d = {theta_d[-1]:.0f} degrees: F beyond is not measured"
        found.append(Remark("angles-missed", text))
    for low, high in pairwise(theta_d):
        if high - low > _GAP:
            found.append(
                Remark("angles-missed", f"no lamp position between theta_d = {low:.0f} and {high:.0f} degrees")
            )
    return found


def _lamp_remarks(capture: Capture, radiometry: Radiometry | None, sphere: tuple[float, float, float]) -> list[Remark]:
    """Return whether the lamp's light scatters more than is stated, by the reference.

    Args:
        capture: what is stated of the lamps.
        radiometry: the light of the reference.
        sphere: column, row and radius, px, from which the place of a diffuse reference is counted; NaN: not known.
    """
    if radiometry is None or capture.reference_place is None:
        return []
    seen = {lamp: out for lamp, out in radiometry.lamp_output.items() if math.isfinite(out.value)}
    if len(seen) < 2:
        return [Remark("no-reference", "the reference is dark, clipped or not there: lamp drift is not measured")]
    light = np.array([out.value for out in seen.values()]) / _nearer(capture, list(seen), sphere)
    light /= light.mean()
    values = dict(zip(seen, light.tolist(), strict=True))
    stated = capture.settings["lamp"]["gain_std"]
    # what is not known of the lamps' directions scatters the light on a diffuse reference, too
    unknown = float(np.mean([(out.std / out.value) ** 2 for out in seen.values()]))
    scatter = math.sqrt(max(float(np.var(light, ddof=1)) - unknown, 0.0))
    if scatter <= 2 * stated + 0.002:
        return []
    worst = max(values, key=lambda lamp: abs(values[lamp] - 1))
    text = f"lamp {worst}: the reference is {values[worst] - 1:+.1%} off the mean of all; they scatter by {scatter:.1%}, and "
    return [Remark("lamp-drifts", f"{text}lamp.gain_std states {stated:.1%}")]


def _nearer(capture: Capture, lamps: Sequence[str], sphere: tuple[float, float, float]) -> np.ndarray:
    """Return the irradiance of near lamps on a diffuse reference over that of distant ones; 1 where it is not determined."""
    reference, region, distance = capture.settings["reference"], capture.reference_place, capture.lamp_radii
    directions = np.array([capture.lamps[lamp].direction for lamp in lamps])
    if reference["kind"] != "diffuse" or region is None or distance is None:
        return np.ones(len(lamps))
    if not (np.isfinite(sphere).all() and np.isfinite(directions).all()):
        return np.ones(len(lamps))
    camera = capture.camera_radii
    ball = MirrorBall(sphere[1], sphere[0], sphere[2], math.inf if camera is None else camera.value)
    depth = 0.0 if reference["depth_mm"] is None or capture.radius_mm is None else reference["depth_mm"][0]
    depth /= 1.0 if capture.radius_mm is None else capture.radius_mm.value
    near, _ = patch_geometry(directions, 1 / distance.value, ReferencePatch(region).place(ball, depth))
    return np.asarray(near / directions[:, 2])


def _outline_remarks(capture: Capture) -> list[Remark]:
    """Return whether the dark disc of the outline frames moved."""
    reader = MosaicReader(capture)
    frames = capture.of("outline")
    found: list[Remark] = []
    given = capture.circle is not None
    if capture.mask is not None and not given:
        try:
            mask_outline(capture.mask, capture.settings["outline"]["mask_std_px"], Sighting(), GUESSED_LENS.value)
            given = True
        except MatcamError as error:
            found.append(Remark("outline-left-out", str(error)))
    if not frames and given:
        return found
    if not frames:
        text = "there is no outline frame: the sphere's radius comes from lit limbs or highlights alone"
        return [*found, Remark("no-outline", text)]
    places = []
    for frame in frames:
        try:
            codes = reader.read(frame, capture.region)
        except FileFormatError as error:
            found.append(Remark("bad-frame", str(error)))
            continue
        places.append((frame, *dark_disc(codes)))
        if field_is_clipped(codes, reader.saturation):
            text = f"{capture.folder / frame.file}: the bright field is clipped, and the sphere looks up to a pixel too small"
            found.append(Remark("outline-clipped", f"{text}; expose outline frames less"))
    for frame, column, row, radius in places:
        path = capture.folder / frame.file
        if not math.isfinite(radius):
            found.append(Remark("no-disc", f"{path}: shows no dark disc inside of a bright field"))
            continue
        first = places[0]
        moved = math.hypot(column - first[1], row - first[2])
        if moved > _MOVED or abs(radius - first[3]) > _MOVED:
            found.append(
                Remark("sphere-moved", f"{path}: the sphere is {moved:.1f} px from where {first[0].file} shows it")
            )
    return found


def dark_disc(codes: np.ndarray) -> tuple[float, float, float]:
    """Return column, row and radius, px, of a dark disc before a bright field, to a few tenths of a pixel.

    From the area and the first moments of what the field lacks. NaN: there is none, or the frame cuts it.

    Args:
        codes: frame, (height, width).
    """
    # 2 x 2 px together: a mosaic's colours
    height, width = (n // 2 * 2 for n in codes.shape)
    cells = codes[:height, :width].reshape(height // 2, 2, width // 2, 2).mean((1, 3), dtype=np.float64)
    dark, bright = np.quantile(cells, [0.01, 0.99])
    lacking = np.clip((bright - cells) / max(bright - dark, 1e-9), 0, 1)
    lacking[lacking < 0.2] = 0
    area = lacking.sum()
    border = np.concatenate([lacking[0], lacking[-1], lacking[:, 0], lacking[:, -1]])
    if bright < 1.5 * max(dark, 1.0) or area < 50 or np.mean(border > 0.5) > 0.02:
        return math.nan, math.nan, math.nan
    rows, columns = np.indices(cells.shape)
    row, column = (float((lacking * index).sum() / area) * 2 + 0.5 for index in (rows, columns))
    return column, row, 2 * math.sqrt(area / math.pi)


def field_is_clipped(codes: np.ndarray, saturation: float) -> bool:
    """Return whether many pixels read the largest code of a file, or of a frame whose dark pixels show noise.

    A frame without noise anywhere is a render, whose even field reads one code unclipped.

    Args:
        codes: frame of the sample before a bright field, (height, width).
        saturation: largest code that the file can hold.
    """
    top = float(codes.max())
    if np.mean(codes == top) < _EVEN:
        return False
    dark = codes < np.percentile(codes, 20)
    pairs = dark[:, 1:] & dark[:, :-1]
    return top >= saturation or (bool(pairs.any()) and bool(np.mean(codes[:, 1:][pairs] == codes[:, :-1][pairs]) < 0.9))


def find_highlights(
    capture: Capture, radiometry: Radiometry | None
) -> tuple[dict[str, tuple[float, float]], list[Remark]]:
    """Return where each lamp position's highlight is, (column, row) px, and which have none.

    The centroid of what is brighter than half of the brightest, in the shortest exposure that shows it.
    """
    reader = MosaicReader(capture)
    order = list(radiometry.exposures) if radiometry is not None else capture.exposures
    reference = capture.reference_region
    found: dict[str, tuple[float, float]] = {}
    remarks: list[Remark] = []
    for lamp in capture.lamps:
        frames = sorted(
            capture.of("frames", lamp=lamp), key=lambda f: order.index(f.exposure) if f.exposure in order else 99
        )
        for frame in frames:
            try:
                place = _brightest(capture, reader, frame, reference)
            except FileFormatError:
                continue
            if place is not None:
                found[lamp] = place
                break
        else:
            if frames:
                remarks.append(
                    Remark("no-highlight", f"{capture.folder / frames[-1].file}: lamp {lamp} shows no highlight")
                )
    return found, remarks


def _brightest(
    capture: Capture, reader: MosaicReader, frame: CaptureFrame, reference: Sequence[int] | None
) -> tuple[float, float] | None:
    codes = reader.read(frame, capture.region).astype(np.float64)
    origin = (0, 0) if capture.region is None else (capture.region[1], capture.region[0])
    if reference is not None:
        column, row, width, height = reference
        rows = slice(max(row - origin[0] - 2, 0), max(row - origin[0] + height + 2, 0))
        codes[rows, max(column - origin[1] - 2, 0) : max(column - origin[1] + width + 2, 0)] = np.median(codes)
    height, width = (n // 2 * 2 for n in codes.shape)
    cells = codes[:height, :width].reshape(height // 2, 2, width // 2, 2).mean((1, 3))
    level = float(np.median(cells))
    noise = 1.4826 * float(np.median(np.abs(cells - level)))
    peak = np.unravel_index(int(cells.argmax()), cells.shape)
    if cells[peak] - level < max(30 * noise, 20.0):
        return None
    bright = np.where(cells - level > 0.5 * (cells[peak] - level), cells - level, 0)
    rows, columns = np.indices(cells.shape)
    bright[np.hypot(rows - peak[0], columns - peak[1]) > 0.1 * max(cells.shape)] = 0
    total = bright.sum()
    return (
        float((bright * columns).sum() / total) * 2 + 0.5 + origin[1],
        float((bright * rows).sum() / total) * 2 + 0.5 + origin[0],
    )


def table_remarks(
    lamps: dict[str, LampGuess], highlights: dict[str, tuple[float, float]], capture: Capture
) -> tuple[tuple[float, float, float], list[Remark]]:
    """Return the sphere that the highlights want, (column, row, radius) px, and which lamp positions contradict it.

    A highlight stands at the centre plus the radius times the mirror normal's (x, -y). Solved by least absolute residuals, so
    that one wrong lamp does not move the sphere.
    """
    names = [lamp for lamp in highlights if np.isfinite(lamps[lamp].direction).all()]
    none = (math.nan, math.nan, math.nan)
    if len(names) < 4:
        return none, []
    camera, lamp_at = (value.value if value else math.inf for value in (capture.camera_radii, capture.lamp_radii))
    normals = np.array([mirror_normal(lamps[name].direction, camera, lamp_at) for name in names])
    places = np.array([highlights[name] for name in names])
    fits = []
    for flip in (-1.0, 1.0):  # rows run down; +1: the azimuths run the other way
        design = np.zeros((2 * len(names), 3))
        design[::2, 0] = design[1::2, 1] = 1
        design[::2, 2], design[1::2, 2] = normals[:, 0], flip * normals[:, 1]
        weight = np.ones(len(names))
        solution = np.zeros(3)
        for _ in range(30):
            twice = np.sqrt(np.repeat(weight, 2))
            solution = np.linalg.lstsq(design * twice[:, None], places.ravel() * twice, rcond=None)[0]
            rest = np.hypot(*(places.ravel() - design @ solution).reshape(-1, 2).T)
            weight = 1 / np.maximum(rest, 0.3)
        fits.append((solution, rest))
    solution, rest = fits[0]
    scatter = float(np.median(rest))
    sphere = (float(solution[0]), float(solution[1]), float(solution[2]))
    spread = float(np.ptp(normals[:, 1]))
    if solution[2] <= 0 or (spread > 0.2 and np.median(fits[1][1]) < 0.2 * scatter and scatter > 2):
        text = "the highlights run against the stated lamp directions: azimuths count from +x (right) towards +y (up)"
        return sphere, [Remark("table-flipped", text)]
    allowed = max(_OFF, 5 * scatter, solution[2] * 2 * capture.direction_std)
    return sphere, [
        Remark(
            "table-contradicts", f"lamp {name}: its highlight is {off:.0f} px from where its stated direction puts it"
        )
        for name, off in zip(names, rest, strict=True)
        if off > allowed
    ]


def mirror_normal(direction: np.ndarray, camera: float, lamp: float) -> np.ndarray:
    """Return the place of the mirror normal in the picture, (x, y) in radii of the limb, x right, y up.

    Args:
        direction: unit vector from the sample's centre to the lamp.
        camera: its distance, radii; infinite: orthographic.
        lamp: the lamp's distance, radii.
    """
    q, w = (0.0 if math.isinf(d) else 1 / d for d in (camera, lamp))
    normal = direction + np.array([0.0, 0.0, 1.0])
    for _ in range(60):
        normal = normal / max(np.linalg.norm(normal), 1e-12)
        light, view = direction - w * normal, np.array([0, 0, 1]) - q * normal
        normal = light / max(np.linalg.norm(light), 1e-12) + view / np.linalg.norm(view)
    normal /= max(np.linalg.norm(normal), 1e-12)
    return math.sqrt(1 - q**2) * normal[:2] / (1 - q * normal[2])
