"""Merging of the exposures of each lamp position into one linear image with its noise.

The value of a pixel that is clipped in every exposure is a lower bound.

The flux f of a pixel is a weighted mean over its exposures: f = sum w d / sum w e. The weights are w = e / (K e f + r^2).
Here d is the dark-subtracted code in an exposure, e the relative exposure, K the gain, and r the read noise. Clipping of a
pixel in an exposure is predicted from shorter exposures, because selection by the noisy code itself would bias the flux.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from matcam.acquisition.bracket_sample import same_colour_neighbours
from matcam.acquisition.light.kept_work import KeptWork, fingerprint, identity
from matcam.acquisition.merged_picture import MergedPicture
from matcam.acquisition.mosaic_frames import MosaicReader, origin_of
from matcam.acquisition.radiometry import Progress, Radiometry, measure_radiometry
from matcam.acquisition.radiometry_remarks import tone_curve_proof
from matcam.core.errors import FitError
from matcam.core.remark import Remark
from matcam.core.threads import in_order
from matcam.files.capture import Capture, Region

_SAFE = 0.93
"""Largest predicted share of the clip level of a usable pixel."""

_KEPT = ("values", "std", "clipped", "channel")
"""Arrays of a merged image that are stored."""


def merge(
    capture: Capture,
    region: Region | None = None,
    progress: Progress | None = None,
    *,
    workers: int = 1,
    kept: KeptWork | None = None,
) -> tuple[list[MergedPicture], Radiometry]:
    """Calibrate a capture radiometrically, and merge the exposures of every lamp position.

    Each worker has the frames of one lamp position in memory. If the capture has a table of lamp intensities, the images are
    divided by them.

    Args:
        capture: the capture.
        region: first column, first row, width, height of the part that is used, px; the first two even. None: that of
            the capture, or the whole frame. Default: None.
        progress: function that is called after each lamp position of both passes. Default: None.
        workers: number of lamp positions that are read at a time. Default: 1.
        kept: cache of results from which an interrupted computation resumes. Default: None, no cache.

    Returns:
        The merged images in the order of the lamps, and the radiometry.

    Raises:
        FitError: no lamp position has a frame that can be read, every frame is dark or clipped, the frames are processed
            (sharpened, tone curve) and accept_processed is not set, or the number of intensities of a lamp is neither 1 nor
            the number of colours.
    """
    radiometry = measure_radiometry(capture, region, progress, workers=workers, kept=kept)
    if not capture.settings["camera"]["accept_processed"]:
        sharpened = next((one for one in radiometry.remarks if one.code == "sharpened"), None)
        if sharpened is not None:
            why = sharpened.text.removesuffix("; use raw frames")
            raise FitError(
                f"{why}: give raw frames, or accept the processed frames with camera.accept_processed = true"
            )
        proof = tone_curve_proof(radiometry.tone_exponent)
        if proof is not None:
            raise FitError(
                f"{capture.folder}: {proof}: give raw frames, specify camera.tone, correct or delete the times, or accept the "
                "frames with camera.accept_processed = true"
            )
    reader = MosaicReader(capture)
    about = "" if kept is None else _fingerprint(capture, radiometry)

    def one(lamp: str) -> MergedPicture:
        if kept is None:
            return merge_position(capture, lamp, radiometry, reader)

        def made() -> dict[str, np.ndarray]:
            picture = merge_position(capture, lamp, radiometry, reader)
            return {name: getattr(picture, name) for name in _KEPT}

        paths = [capture.folder / frame.file for frame in radiometry.used[lamp]]
        found = kept.store(f"merged {lamp} {about}\n{identity(paths)}", made)
        parts = {name: found[name] for name in _KEPT}
        return MergedPicture(lamp, **parts, channels=radiometry.channels, origin=origin_of(radiometry.region))

    pictures = []
    for picture in in_order(one, list(radiometry.used), workers):
        pictures.append(picture)
        if progress:
            progress("merging", len(pictures), len(radiometry.used))
    return _under_one_light(pictures, capture), radiometry


def _under_one_light(pictures: Sequence[MergedPicture], capture: Capture) -> list[MergedPicture]:
    if capture.settings["lamp"]["intensity"] != "table":
        return list(pictures)
    stated = {one.name: np.array(capture.lamps[one.name].intensity) for one in pictures}
    mean = float(np.mean([light.mean() for light in stated.values()]))
    found = []
    for one in pictures:
        light = stated[one.name] / mean
        if len(light) not in (1, len(one.channels)):
            raise FitError(
                f"{capture.folder}: the number of intensities of lamp {one.name} is {len(light)}, but it must be 1 or the "
                f"number of colours of the images, {len(one.channels)}"
            )
        share = np.broadcast_to(light, len(one.channels))[one.channel]
        found.append(replace(one, values=one.values / share, std=one.std / share))
    return found


def _fingerprint(capture: Capture, radiometry: Radiometry) -> str:
    known = radiometry.to_dict()
    del known["remarks"], known["lamp_output"], known["reference_between"]
    flat = () if radiometry.flat is None else (radiometry.flat.response, radiometry.flat.std)
    levels = [value for one in radiometry.darkness.values() for value in (one.level, one.hot)]
    return fingerprint(known, capture.settings["camera"], radiometry.region, *levels, *flat)


def merge_position(
    capture: Capture, lamp: str, radiometry: Radiometry, reader: MosaicReader | None = None
) -> MergedPicture:
    """Merge the exposures of one lamp position.

    Args:
        capture: the capture.
        lamp: name of the lamp position.
        radiometry: radiometric calibration.
        reader: the reader of frames. Default: None, a new reader.

    Returns:
        The image in electrons (or DN, see `radiometry.unit`) of the reference exposure.
    """
    reader = reader or MosaicReader(capture)
    frames = radiometry.used[lamp]
    region = radiometry.region
    clip, noise = radiometry.clip, radiometry.read_noise.value
    gain = radiometry.scale
    codes = [reader.read(frame, region) for frame in frames]
    relative = np.array([radiometry.exposures[frame.exposure].value for frame in frames])
    light, full, hot = [], [], np.zeros(codes[0].shape, bool)
    heights = []
    for frame, code in zip(frames, codes, strict=True):
        dark = radiometry.darkness[frame.exposure]
        light.append(code - np.asarray(dark.level, np.float32))
        full.append(code >= clip.threshold)
        heights.append(clip.level - dark.mean)
        hot |= dark.hot_pixels(hot.shape)
    use = _usable(light, full, relative, heights, noise, reader.step, bool(clip.pixels))
    flux, variance = _weighted(light, use, relative, gain, noise, reader.step)
    none = ~np.any(use, axis=0)
    # for a pixel that is clipped in all exposures, the clip level of the shortest exposure is a lower bound
    floor = min(heights[0], clip.threshold - (clip.level - heights[0])) / relative[0]
    flux = np.where(none, floor, flux)
    variance = np.where(none, (gain * floor * relative[0] + noise**2) / relative[0] ** 2, variance)
    values, std = (flux / gain).astype(np.float32), (np.sqrt(variance) / gain).astype(np.float32)
    flat = radiometry.flat
    channel = reader.channel_map(values.shape, region)
    if flat is not None:
        values, std = values / flat.response, std / flat.response
        std = np.hypot(std, values * flat.std.astype(np.float32)[channel])
        hot |= np.isnan(flat.response)
    values[hot], std[hot] = np.nan, np.nan
    return MergedPicture(lamp, values, std, none & ~hot, channel, radiometry.channels, origin_of(region))


def bracket_misfit(capture: Capture, lamp: str, radiometry: Radiometry, picture: MergedPicture) -> float:
    """Compute the misfit between the exposures of a lamp position, chi2 per degree of freedom.

    A value well above 1 indicates that the sample, camera or lamp moved between the exposures. The result is NaN if no
    pixel is bright enough.
    """
    reader = MosaicReader(capture)
    noise = radiometry.read_noise.value
    gain = radiometry.scale
    total, count = 0.0, 0
    flat, std = radiometry.flat, picture.std
    response = np.ones_like(std) if flat is None else np.nan_to_num(flat.response)
    if flat is not None:  # errors of the pixels are common to all exposures
        std = np.sqrt(np.maximum(std**2 - (picture.values * flat.std[picture.channel]) ** 2, 0))
    steep = np.nan_to_num(picture.values) * response * gain
    for frame in radiometry.used[lamp]:
        relative = radiometry.exposures[frame.exposure].value
        dark = radiometry.darkness[frame.exposure]
        code = reader.read(frame, radiometry.region)
        mean = relative * steep
        # only pixels of 30 times the read noise test the agreement of the exposures
        good = (mean > 30.0 * noise) & (mean < _SAFE * (radiometry.clip.level - dark.mean)) & ~picture.clipped
        good &= (code < radiometry.clip.threshold) & np.isfinite(picture.values)
        residual = (code - dark.level)[good] - mean[good]
        # the mean contains this frame, which reduces the variance of the residual by that of the mean
        own = (gain * mean[good] + noise**2) - (relative * (std * response)[good] * gain) ** 2
        kept = own > 0.05 * (gain * mean[good] + noise**2)
        total += float(np.sum(residual[kept] ** 2 / own[kept]))
        count += int(kept.sum())
    return total / count if count else float("nan")


def misfit_remark(lamp: str, misfit: float) -> Remark | None:
    if not misfit > 2.0:
        return None
    return Remark(
        "bracket-moved",
        f"lamp {lamp}: the differences between the exposures are {math.sqrt(misfit):.1f} times the expected noise: fasten "
        "sample, camera and lamp, and repeat the exposures",
    )


def _usable(
    light: list[np.ndarray],
    full: list[np.ndarray],
    relative: np.ndarray,
    heights: list[float],
    noise: float,
    step: int,
    seen: bool,
) -> np.ndarray:
    """Compute the mask of the pixels that are usable in each of k exposures, (k, height, width)."""
    use = np.stack([~one for one in full])
    if not seen:
        return use
    total, weight = np.zeros_like(light[0]), np.zeros_like(light[0])
    for k in range(1, len(light)):
        total += np.where(use[k - 1], light[k - 1], 0)
        weight += np.where(use[k - 1], relative[k - 1], 0).astype(np.float32)
        predicted = np.where(weight > 0, total / np.maximum(weight, 1e-30), np.inf)
        use[k] &= (relative[k] * predicted < _SAFE * heights[k]) | (
            # the pixel is dim in the shorter exposure, so the light of the neighbours is a better estimate
            (predicted * relative[k - 1] < 8 * noise) & (same_colour_neighbours(light[k], step) < _SAFE * heights[k])
        )
    return use


def _weighted(
    light: list[np.ndarray], use: np.ndarray, relative: np.ndarray, gain: float, noise: float, step: int
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the flux of every pixel, DN at the reference exposure, and its variance, DN^2, both float32."""
    top, under, own = (np.zeros(light[0].shape, np.float32) for _ in range(3))
    for one, d, e in zip(use, light, relative.astype(np.float32), strict=True):
        top += np.multiply(d, one, out=own)
        under += np.multiply(one, e, out=own)
    flux = top / np.maximum(under, 1e-30)
    # weights from the pixel itself would bias it low, so its neighbours determine the expected variance if the pixel
    # agrees with them within noise
    around = same_colour_neighbours(flux, step)
    np.maximum(under, np.float32(relative.min()), out=under)
    variance = (np.float32(gain) * np.maximum(around, 0) + np.float32(len(light) * noise**2) / under) / under
    # largest difference of a pixel from the neighbours that determine its variance, in standard deviations
    agrees = (flux - around) ** 2 < 4.0**2 * variance
    # weights from a dim noisy pixel itself would bias its flux
    agrees |= around * np.float32(relative[-1]) < 10.0 * noise
    flux = np.maximum(np.where(agrees, around, flux), 0)
    top[:], under[:] = 0, 0
    for one, d, e in zip(use, light, relative.astype(np.float32), strict=True):
        np.multiply(flux, np.float32(gain) * e, out=own)
        own += np.float32(noise**2)
        weight = np.divide(e, own, out=own)
        weight *= one
        under += weight * e
        weight *= d
        top += weight
    np.maximum(under, 1e-30, out=under)
    return top / under, 1 / under
