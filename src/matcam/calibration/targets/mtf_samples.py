"""MTF samples: values of the MTF and their covariance, the common result of all targets for the joint fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from matcam.calibration.photograph.linear_image import LinearImage
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.io import plain


@dataclass(frozen=True, eq=False)
class MTFSamples:
    """MTF of a camera at n frequencies and one position.

    The MTF is signed, and includes optics and pixel.

    Attributes:
        kind: target: "edge", "grating", "star" or "dots".
        position: (x, y) of the middle of the target in the image, px; pixel centres have integer coordinates, and row 0 is at
            the top.
        frequency: (n,) positive frequencies, cycles/px of the full pixel grid, also for a plane of a mosaic.
        direction: (n,) angle from the rows of the image to the frequency vector, rad; x right, y down; defined modulo pi.
        mtf: (n,) MTF, no unit.
        covariance: (n, n) covariance of `mtf`; common errors (levels, contrast, position) cause off-diagonal entries.
        channel: "R", "G", "B", "Y" (luminance) or "grey". Default: "grey".
        f_number: f-number of the image (no unit). Default: None, the f-number is unknown.
        source: file and target, for messages and the provenance of a profile. Default: "".

    Raises:
        ArgumentError: if `kind` is unknown, shapes disagree, a value is not finite, or a frequency or a variance is not
            positive.

    Source:
        docs/targets.md.

    Example:
        >>> samples = matcam.targets.MTFSamples("star", (320.0, 240.0), [0.1, 0.2], [0, 0], [0.93, 0.75], np.diag([1e-4, 4e-4]))
        >>> samples.mtf_std
        array([0.01, 0.02])
    """

    kind: str
    position: tuple[float, float]
    frequency: np.ndarray
    direction: np.ndarray
    mtf: np.ndarray
    covariance: np.ndarray
    channel: str = "grey"
    f_number: float | None = None
    source: str = ""

    def __post_init__(self) -> None:
        checks.choice("kind", self.kind, ("edge", "grating", "star", "dots"))
        count = np.size(self.frequency)
        for name in ("frequency", "direction", "mtf"):
            values = np.asarray(getattr(self, name), dtype=np.float64)
            if values.shape != (count,) or not np.isfinite(values).all() or not count:
                raise ArgumentError(
                    f"{name} must have {count or 'at least 1'} finite values, got {np.isfinite(values).sum()} finite values "
                    f"in shape {values.shape}"
                )
            object.__setattr__(self, name, values)
        if (self.frequency <= 0).any():
            raise ArgumentError(f"frequency must be positive, got {self.frequency.min():g} cycles/px")
        covariance = np.asarray(self.covariance, dtype=np.float64)
        if covariance.shape != (count, count) or not np.isfinite(covariance).all():
            raise ArgumentError(
                f"covariance must be finite and of shape ({count}, {count}), got shape {covariance.shape}"
            )
        variance = np.diag(covariance)
        if (
            not (variance > 0).all()
            or (np.abs(covariance - covariance.T) > 1e-6 * np.sqrt(np.outer(variance, variance))).any()
        ):
            raise ArgumentError("covariance must be symmetric, with positive variances")
        object.__setattr__(self, "covariance", covariance)

    @classmethod
    def of_region(
        cls, kind: str, region: LinearImage, middle: Sequence[float] | np.ndarray, frequency: np.ndarray, direction: np.ndarray,
        mtf: np.ndarray, covariance: np.ndarray,
    ) -> MTFSamples:  # fmt: skip
        """Create the samples of a target in a region of an image.

        Args:
            kind: target: "edge", "grating", "star" or "dots".
            region: region of the image that contains the target, with its corner, channel, f-number and source.
            middle: (x, y) of the middle of the target in the region, px.
            frequency: (n,) frequencies, cycles/px.
            direction: (n,) directions, rad.
            mtf: (n,) MTF, no unit.
            covariance: (n, n) covariance of `mtf`.

        Returns:
            The samples, with the position of the target in the whole image.
        """
        position = (float(middle[0] + region.corner[0]), float(middle[1] + region.corner[1]))
        return cls(
            kind, position, frequency, direction, mtf, covariance, region.channel, region.f_number, region.source
        )

    @property
    def mtf_std(self) -> np.ndarray:
        """Standard deviations (n,) of `mtf`."""
        return np.sqrt(np.diag(self.covariance))

    def to_dict(self) -> dict[str, Any]:
        """Convert the samples to a JSON object.

        Returns:
            All attributes, with units in the names of those that have one, and the standard deviations.
        """
        return with_units(self, position="px", frequency="cycles_per_px", direction="rad", mtf_std=None)


def with_units(result: Any, **units: str | None) -> dict[str, Any]:
    """Convert a result to a JSON object: all of its fields and the named properties.

    `units`: unit of each named field or property, which is appended to the name; None if there is no unit.
    """
    names = dict.fromkeys(field.name for field in fields(result)) | units
    return plain({f"{name}_{unit}" if unit else name: getattr(result, name) for name, unit in names.items()})
