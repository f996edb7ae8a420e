"""Many edges at once: the same program on ten of them side by side, over and over.

The slanted edge (ISO 12233): a camera's MTF from one picture of one edge, with error bars.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from matcam.calibration.edge.edge_result import EdgeMTF, result_of
from matcam.calibration.edge.maximum_likelihood import Noise
from matcam.calibration.edge.measurement import fit_lens, measure, measure_stack
from matcam.calibration.edge.profiles import MODELS, LensModel, lens_model
from matcam.calibration.photograph import region
from matcam.calibration.photograph import region as verdict
from matcam.calibration.photograph.linear_image import SMALLEST, LinearImage, region_of
from matcam.calibration.photograph.region import Frame, Region
from matcam.calibration.photograph.tone import Tone
from matcam.core import checks
from matcam.core.errors import ArgumentError, FitError
from matcam.core.jax import jax
from matcam.files.photographs import Photograph

AT_ONCE = 10
"""Edges that run side by side: they fit into the processor's cache."""


def measured(
    regions: Iterable[tuple[Region, list[str]]], model: str, lens: LensModel, noise: Noise, half_width: float, *,
    accept_sharpened: bool,
) -> EdgeMTF:  # fmt: skip
    """Result of all edges in regions of one shape, each of at most `AT_ONCE`, with what is wrong with each picture of
    theirs beforehand ("": nothing)."""
    half = np.float64(half_width)
    chunks, frames = [], []
    problems: list[str] = []
    for rows, flaws in regions:
        count = len(rows.value)
        # always as many at once, so that one compiled program serves every stack; what fills the last one up is thrown away
        y, start = (np.broadcast_to(a, (count, a.shape[-1])) for a in (rows.y, rows.start))
        value, y, start = (_filled(a) for a in (rows.value, y, start))
        found = measure_stack(value, y, start, noise, half, step=rows.step, turns=rows.turns)
        if model != "gaussian":
            found = found._replace(parametric=jax.vmap(fit_lens, in_axes=(0, None, None))(found, half, lens))
        # one after the other: programs that are queued on a processor compete for its threads
        found = jax.tree.map(np.asarray, found)
        chunks.append(jax.tree.map(lambda a: a[:count], found))  # noqa: B023
        refusals = verdict.refusals(chunks[-1], rows, accept_sharpened=accept_sharpened)
        problems += [flaw or refusal for flaw, refusal in zip(flaws, refusals, strict=True)]
        frames.append(Frame(*(np.broadcast_to(column, count) for column in rows.frame)))
    found = jax.tree.map(lambda *a: np.concatenate(a), *chunks)
    frame = Frame(*(np.concatenate(columns) for columns in zip(*frames, strict=True)))
    return result_of(found, frame, model, lens, half_width, tuple(problems))


def _filled(rows: np.ndarray) -> np.ndarray:
    return np.concatenate([rows, np.repeat(rows[:1], AT_ONCE - len(rows), axis=0)])


_FULL = 0.5  # px: a pixel that is sensitive all over
_UNKNOWN = Noise(np.float64(np.nan), np.float64(np.nan))


def edge_mtf(
    image: ArrayLike | Photograph | LinearImage,
    roi: Sequence[int] | None = None,
    *,
    model: str = "gaussian",
    wavelength: float | None = None,
    pixel_pitch: float | None = None,
    half_width: float = 0.5,
    cfa: str | None = None,
    channel: str | None = None,
    tone: Tone = "linear",
    gain: float | None = None,
    read_noise: float | None = None,
    accept_sharpened: bool = False,
) -> EdgeMTF:
    """MTF of lens and pixel along the normal of the one slanted edge in a region (MODEL 7, ISO 12233).

    image: (height, width), or (height, width, 3) for R, G, B; linear, NaN where there are no data. roi: (x, y, width,
    height) px; None: all of it. At least 16 x 16 px; better 80 across the edge and 160 along it. The edge may be bowed by
    a few px and lit unevenly, at any angle whose pixels see it in different phases: not along the grid, nor at 45 degrees.

    model: of the parametric estimate: "gaussian", "diffraction", "defocus" (diffraction and defocus) or "halo" (Gaussian
    with veiling glare). wavelength, pixel_pitch: m; needed by "diffraction" and "defocus". half_width: of the pixel's
    sensitive area, px, (0, 0.5].
    cfa: colours of the picture's first 2 x 2 px, row by row ("RGGB", ...): the image is a mosaic, and the sites of
    `channel` ("R", "G", "B") are samples as they are; nothing is demosaiced. channel with a colour image: "R", "G", "B"
    or "Y", their luminance (default).
    tone: "linear"; "srgb": undone; a gamma; a table of linear values by code, one or three columns; or "auto".
    gain, read_noise: a pixel's variance is gain * value + read_noise^2, in the linear image's units (counts of
    photo-electrons have gain 1); None: estimated.
    accept_sharpened: measure a sharpened picture all the same: lens and sharpening together.

    Returns `EdgeMTF`. Raises ArgumentError for bad arguments, FitError where the region holds no edge that can be
    measured; each says why. Method, accuracy and their tests: docs/edge.md.
    """
    lens, noise, half = _checked(model, wavelength, pixel_pitch, half_width, gain, read_noise)
    picture = region_of(image, roi, channel=channel, cfa=cfa, tone=tone)
    values = picture.values[None]
    if problem := region.flaws(values)[0]:
        raise FitError(problem)
    rows = region.rows_of(values, mosaic=picture.cfa is not None)
    found = measure(rows.value[0], rows.y, rows.start, noise, half, step=rows.step, turns=rows.turns)
    if model != "gaussian":
        found = found._replace(parametric=fit_lens(found, half, lens))
    found = jax.tree.map(np.asarray, found)
    if problem := verdict.refusals(jax.tree.map(lambda a: a[None], found), rows, accept_sharpened=accept_sharpened)[0]:
        raise FitError(problem)
    corner = picture.corner
    frame = rows.frame._replace(x=rows.frame.x + corner[0], y=rows.frame.y + corner[1])
    return result_of(found, frame, model, lens, half_width, ())


def edge_mtf_stack(
    images: ArrayLike,
    *,
    model: str = "gaussian",
    wavelength: float | None = None,
    pixel_pitch: float | None = None,
    half_width: float = 0.5,
    gain: float | None = None,
    read_noise: float | None = None,
    accept_sharpened: bool = False,
) -> EdgeMTF:
    """`edge_mtf` for a stack of grey, linear regions (n, height, width), several times faster than one at a time.

    All edges lie alike: all nearer to vertical, or all nearer to horizontal. Other arguments: those of `edge_mtf`. Every
    number of the result has a leading axis of n; `result[i]` is one edge's. An edge that cannot be measured is NaN, and
    `result.problems[i]` says why. Raises ArgumentError.
    """
    lens, noise, _ = _checked(model, wavelength, pixel_pitch, half_width, gain, read_noise)
    values = np.asarray(images)
    if values.dtype.kind not in "uif" or values.ndim != 3 or min(values.shape[1:]) < SMALLEST or not len(values):
        raise ArgumentError(
            f"images must be numbers of shape (n, height, width), n >= 1, sides >= {SMALLEST}, got {values.dtype} "
            f"{values.shape}"
        )
    regions = []
    for i in range(0, len(values), AT_ONCE):
        some = values[i : i + AT_ONCE].astype(np.float64)
        regions.append((region.rows_of(some), region.flaws(some)))
        if regions[-1][0].frame.transposed != regions[0][0].frame.transposed:
            raise ArgumentError(
                f"images must hold edges that lie alike: those from number {i} on lie across the first ones"
            )
    return measured(regions, model, lens, noise, half_width, accept_sharpened=accept_sharpened)


def _checked(
    model: str, wavelength: float | None, pixel_pitch: float | None, half_width: float, gain: float | None,
    read_noise: float | None,
) -> tuple[LensModel, Noise, np.float64]:  # fmt: skip
    checks.choice("model", model, MODELS)
    if model in ("diffraction", "defocus"):
        for name, value in (("wavelength", wavelength), ("pixel_pitch", pixel_pitch)):
            if value is None:
                raise ArgumentError(f"{name} must be given for the {model} model, m")
        checks.within("wavelength", float(wavelength or 0), 1e-9, 1e-3, "m (550 nm is 550e-9)")
        checks.within("pixel_pitch", float(pixel_pitch or 0), 1e-8, 1e-2, "m (5 um is 5e-6)")
    half = np.float64(_FULL)
    if half_width != _FULL:
        half = np.float64(
            checks.scalar("half_width", checks.within("half_width", half_width, 0, 0.5, "px", open_low=True))
        )
    if (gain is None) != (read_noise is None):
        raise ArgumentError("gain and read_noise must be given together, or neither: then both are estimated")
    noise = _UNKNOWN
    if gain is not None and read_noise is not None:
        checks.within("gain", gain, 0, np.inf, open_high=True)
        checks.within("read_noise", read_noise, 0, np.inf, open_high=True)
        if not (gain > 0 or read_noise > 0):
            raise ArgumentError("gain and read_noise must not both be 0: no picture is without noise")
        noise = Noise(np.float64(gain), np.float64(read_noise))
    return lens_model(model, wavelength, pixel_pitch), noise, half
