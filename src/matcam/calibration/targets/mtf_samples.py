"""What every way of measuring a camera hands to the fit that joins them: values of the MTF, and their covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from matcam.core.errors import ArgumentError

KINDS = ("edge", "grating", "star", "dots")


@dataclass(frozen=True, eq=False)
class MTFSamples:
    """The effective camera's MTF (optics and pixel, signed) as it was found at n frequencies in one place of one picture.

    Raises ArgumentError where shapes disagree, a number is not finite, or a variance is not positive.
    """

    kind: str
    """Of the target: "edge", "grating", "star", "dots"."""
    position: tuple[float, float]
    """(x, y) px of the target's middle in the picture, pixel centres on whole numbers, row 0 on top."""
    frequency: np.ndarray
    """(n,) cycles/px, positive: on the sensor's full grid, whatever plane of a mosaic was measured."""
    direction: np.ndarray
    """(n,) rad, of the frequency to the picture's rows: x right, y down. Even: direction + pi means the same."""
    mtf: np.ndarray
    """(n,)"""
    covariance: np.ndarray
    """(n, n) of `mtf`: errors that the samples share (levels, contrast, place) stand off the diagonal."""
    channel: str = "grey"
    """"R", "G", "B", "Y" (luminance) or "grey"."""
    aperture: float | None = None
    """f-number of the picture; None: not known."""
    source: str = ""
    """File and region, for messages and the profile's provenance."""

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ArgumentError(f"kind must be one of {', '.join(KINDS)}, got {self.kind!r}")
        count = np.size(self.frequency)
        for name in ("frequency", "direction", "mtf"):
            values = np.asarray(getattr(self, name), dtype=np.float64)
            if values.shape != (count,) or not np.isfinite(values).all() or not count:
                raise ArgumentError(f"{name} must be {count or 'at least 1'} finite numbers, got shape {values.shape}")
            object.__setattr__(self, name, values)
        if (self.frequency <= 0).any():
            raise ArgumentError(f"frequency must be positive, got {self.frequency.min():g} cycles/px")
        covariance = np.asarray(self.covariance, dtype=np.float64)
        if covariance.shape != (count, count) or not np.isfinite(covariance).all():
            raise ArgumentError(f"covariance must be ({count}, {count}) finite numbers, got shape {covariance.shape}")
        variance = np.diag(covariance)
        if (
            not (variance > 0).all()
            or (np.abs(covariance - covariance.T) > 1e-6 * np.sqrt(np.outer(variance, variance))).any()
        ):
            raise ArgumentError("covariance must be symmetric, with positive variances")
        object.__setattr__(self, "covariance", covariance)

    @property
    def mtf_std(self) -> np.ndarray:
        """(n,) standard deviations of `mtf`."""
        return np.sqrt(np.diag(self.covariance))
