"""Edge-based spatial frequency response (e-SFR), computed in the steps of ISO 12233:2023.

In contrast to `edge_mtf`, the method does not provide standard deviations, does not model uneven light, and is biased by its
bins and windows. It is intended for the comparison with other programs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from matcam.calibration.edge.free_curve import SampledCurve
from matcam.calibration.edge.rows import edge_region
from matcam.calibration.photograph.linear_image import LinearImage
from matcam.calibration.photograph.tone import Tone
from matcam.calibration.readings.edge_numbers import LEVELS, rise
from matcam.core.arrays import FloatArray
from matcam.core.errors import ArgumentError, FitError, RegionError
from matcam.core.io import plain
from matcam.files.photographs import Photograph
from matcam.numerics.crossing import first_fall

_BINS = 4
"""Number of bins of the edge spread function per sample (ISO 12233:2023)."""


@dataclass(frozen=True, eq=False)
class ISOEdge:
    """Spatial frequency response of one edge according to ISO 12233:2023.

    Attributes:
        frequency: frequencies (n,) along the normal of the edge, cycles/px.
        sfr: spatial frequency response (n,) (no unit).
        sfr50: lowest frequency at which `sfr` is one half, cycles/px; NaN if `sfr` does not fall to one half.
        sfr10: lowest frequency at which `sfr` is one tenth, cycles/px; NaN if `sfr` does not fall to one tenth.
        slope: mean angle between the edge and the columns, or the rows if the edge is nearer to horizontal, rad.
        esf: edge spread function (m,), in the linear units of the image.
        spacing: distance between the samples of `esf` along the normal, px.

    Example:
        >>> y, x = np.mgrid[-80:80, -40:40]
        >>> result = matcam.calibration.iso12233_sfr(100 + 800 / (1 + np.exp(-2 * (x - 0.1 * y))))
        >>> round(result.sfr50, 2)
        0.22
    """

    frequency: FloatArray
    sfr: FloatArray
    sfr50: float
    sfr10: float
    slope: float
    esf: FloatArray
    spacing: float

    def readings(self, frequencies: Sequence[float] = ()) -> dict[str, Any]:
        """Compute the scalar metrics that are usually reported for the response.

        Args:
            frequencies: frequencies at which the response is computed, cycles/px. Default: (), no frequencies.

        Returns:
            Values by name, with units in the names, as `matcam edge` prints them.
        """
        found: dict[str, Any] = {}
        for level in LEVELS:
            found[f"mtf{100 * level:.0f}_cycles_per_px"] = float(first_fall(self.frequency, self.sfr, level))
        found["rise_10_90_px"] = self.rise
        return found | {f"mtf_at_{f:g}": float(np.interp(f, self.frequency, self.sfr)) for f in frequencies}

    @property
    def rise(self) -> float:
        """Rise distance (10 % to 90 %) of the edge, px.

        The distance is NaN if the edge spread function does not reach 10 % and 90 %.
        """
        end = max(self.esf.size // 8, 1)
        dark, bright = self.esf[:end].mean(), self.esf[-end:].mean()
        share = (self.esf - dark) / (bright - dark)
        position = self.spacing * np.arange(share.size)
        return rise(position, SampledCurve(share, np.zeros(share.size))).value

    def to_dict(self) -> dict[str, Any]:
        """Convert the result to a JSON object.

        Returns:
            Values by name, with units in the names; the angle is in degrees.
        """
        return plain(
            {
                "method": "iso12233",
                "mtf50_cycles_per_px": self.sfr50,
                "mtf10_cycles_per_px": self.sfr10,
                "slope_deg": np.degrees(self.slope),
                "frequency_cycles_per_px": self.frequency,
                "mtf": self.sfr,
                "esf": self.esf,
                "spacing_px": self.spacing,
            }
        )


def iso12233_sfr(
    image: ArrayLike | Photograph | LinearImage,
    roi: Sequence[int] | None = None,
    *,
    order: int = 5,
    cfa: str | None = None,
    channel: str | None = None,
    tone: Tone = "auto",
) -> ISOEdge:
    """Measure the e-SFR of an edge by the steps of ISO 12233:2023.

    The e-SFR is the edge-based spatial frequency response. In each row, the position of the edge is the centroid of the
    windowed derivative. A polynomial through these positions aligns the rows. The edge spread function is averaged in
    four bins per sample. Its derivative is multiplied by a Tukey window and Fourier transformed. Finally, the result is
    corrected for the response of the difference filter.

    Args:
        image: `LinearImage`, `Photograph`, or array, as in `edge_mtf`.
        roi: region (x, y, width, height) that contains one edge, px. Default: None, the whole image.
        order: order of the polynomial of the edge, 1 to 5 (no unit). Default: 5.
        cfa: colours of the first 2 x 2 px of the image, as in `edge_mtf` (no unit). Default: None, no mosaic.
        channel: "R", "G", "B" or "Y", as in `edge_mtf` (no unit). Default: None, luminance.
        tone: tone curve of the codes, as in `LinearImage.of` (no unit). Default: "auto", as in `edge_mtf`.

    Returns:
        The response, without standard deviations.

    Raises:
        ArgumentError: an argument is invalid.
        FitError: the region contains no edge or has missing pixels, or the pixels do not sample all phases of the edge.

    Source:
        ISO 12233:2023, annex D; P. D. Burns, sfrmat5.

    Example:
        >>> y, x = np.mgrid[-80:80, -40:40]
        >>> image = 100 + 800 / (1 + np.exp(-2 * (x - 0.1 * y)))
        >>> ours, standard = matcam.edge_mtf(image), matcam.calibration.iso12233_sfr(image)
        >>> abs(ours.mtf50 / standard.sfr50 - 1) < 0.03
        True
    """
    if not (isinstance(order, int) and 1 <= order <= 5):
        raise ArgumentError(f"order must be a whole number from 1 to 5, got {order!r:.40}")
    _, rows = edge_region(image, roi, channel, cfa, tone)
    value = rows.value[0][np.isfinite(rows.value[0]).any(1)]
    value = value[:, np.isfinite(value).all(0)]
    start = rows.start[0, : len(value)] / rows.step
    number = np.arange(len(value), dtype=float)
    if value.shape[1] < 8:
        raise RegionError(
            "the region has missing pixels, but ISO 12233 requires complete rows: choose a region without missing pixels"
        )
    place = _edge_positions(value, start, number, order)
    straight = np.polynomial.Polynomial.fit(number, place, 1).convert().coef[1]
    # The edge must shift by one sample between the first and the last row, so that all phases are sampled.
    if abs(straight) * len(value) < 1.0:
        raise FitError(
            "the edge is nearly parallel to the pixel grid, which samples too few distances from the edge: rotate the "
            "target by a few degrees"
        )
    # A whole number of phase cycles gives all phases equal weight.
    kept = max(int(np.round(np.floor(len(value) * abs(straight)) / abs(straight))), 1)
    value, start, place = value[:kept], start[:kept], place[:kept]
    esf = _edge_spread(value, start[:, None] + np.arange(value.shape[1]) - place[:, None])
    # Convert distances to px along the normal.
    across = float(np.cos(np.arctan(straight * rows.step / (rows.y[0, 1] - rows.y[0, 0]))))
    spacing = rows.step * across / _BINS
    frequency, sfr = _response(esf, spacing)
    sfr50, sfr10 = (float(first_fall(frequency, sfr, level)) for level in (0.5, 0.1))
    return ISOEdge(frequency, sfr, sfr50, sfr10, float(np.arccos(across)), esf, spacing)


def _edge_positions(value: FloatArray, start: FloatArray, number: FloatArray, order: int) -> FloatArray:
    """Find the position of the edge in every row, in samples.

    The positions are those of a polynomial that is fitted to the centroids of the windowed derivative. `start`: position of
    the first sample of each row, in samples. `number`: index of each row.
    """
    columns = value.shape[1]
    # The difference of two neighbours belongs to the point between them.
    slope, at = np.diff(value, axis=1), start[:, None] + np.arange(columns - 1) + 0.5
    window = np.ones_like(slope)
    for _ in range(3):
        weight = slope * window
        total = weight.sum(1)
        if not (total > 0).all():
            raise RegionError("no edge was found: choose a region that an edge crosses from one side to the other")
        middle = np.polynomial.Polynomial.fit(number, (weight * at).sum(1) / total, order)(number)
        # The smallest weight of 0.05 stabilises the repeated search.
        window = 0.95 * _hann(at - middle[:, None], columns) + 0.05
    return middle


def _hann(distance: FloatArray, width: float) -> FloatArray:
    """Compute a Tukey window with parameter 1, centred on the edge, that extends to the more distant end of the row."""
    half = np.maximum(np.abs(distance).max(axis=-1, keepdims=True), width / 2)
    return (1 + np.cos(np.pi * np.clip(distance / half, -1, 1))) / 2


def _edge_spread(value: FloatArray, distance: FloatArray) -> FloatArray:
    """Average samples over bins of a quarter of a sample, and interpolate empty bins. `distance` is in samples."""
    bins = np.floor(distance * _BINS).astype(int)
    # Only bins within half a row length of the centre are used, because not all rows contribute to the outer bins.
    middle, half = int(np.round((bins[:, 0] + bins[:, -1]).mean() / 2)), _BINS * value.shape[1] // 2
    first, last = max(middle - half, int(bins.min())), min(middle + half - 1, int(bins.max()))
    inside = (bins >= first) & (bins <= last)
    count = np.bincount(bins[inside] - first, minlength=last - first + 1)
    total = np.bincount(bins[inside] - first, value[inside], last - first + 1)
    known = count > 0
    if known.sum() < 2 * _BINS:
        raise RegionError("the edge leaves the region: choose a region whose middle the edge crosses")
    positions = np.arange(count.size)
    return np.interp(positions, positions[known], total[known] / count[known])


def _response(esf: FloatArray, spacing: float) -> tuple[FloatArray, FloatArray]:
    """Compute frequencies, cycles/px, and the response. `esf`: edge spread function. `spacing`: distance of its samples, px."""
    line = np.convolve(esf, (0.5, 0, -0.5), "same")
    line[[0, -1]] = line[[1, -2]]
    # Shift the maximum to the centre.
    line = np.roll(line, line.size // 2 - int(np.argmax(line)))
    line *= _hann(np.arange(line.size, dtype=float) - line.size // 2, line.size)
    size = line.size
    spectrum = np.abs(np.fft.rfft(line))
    frequency = np.arange(spectrum.size) / (size * spacing)
    phase = 2 * np.pi * np.arange(spectrum.size) / size
    with np.errstate(divide="ignore", invalid="ignore"):
        filtered = np.where(phase > 0, np.abs(np.sin(phase) / phase), 1.0)
    # The correction is limited to a factor of 10.
    corrected = spectrum / spectrum[0] * np.minimum(1 / np.maximum(filtered, 1e-12), 10.0)
    shown = frequency <= 1 / (2 * spacing * _BINS) * 2
    return frequency[shown], corrected[shown]
