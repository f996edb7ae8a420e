"""Data of the calibrate view: photographs and the measurements in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from matcam.core.errors import FileFormatError, FitError, MatcamError
from matcam.core.io import json_text
from matcam.core.readers.names import is_file

_LARGEST = 120_000_000
"""Largest number of pixels of a displayed image, which limits the memory of the app."""


@dataclass(frozen=True)
class OpenedPicture:
    """Photograph, and its displayed version.

    Attributes:
        path: path of the file.
        photograph: values of the file.
        shown: displayed pixels in the order of the file, subsampled for the page, 0 to 1, encoded for a screen.
        about: description of name, size, colours, kind of values and subsampling.
    """

    path: Path
    photograph: Any
    shown: np.ndarray
    about: str

    @property
    def size(self) -> tuple[int, int]:
        """Height and width, px."""
        height, width = self.photograph.values.shape[:2]
        return height, width


def open_picture(path: Path) -> OpenedPicture:
    """Read a photograph.

    Raises:
        FileFormatError: the file is missing, damaged, too large, or of an unknown format.
    """
    from matcam.files.photographs import open_photograph

    photograph = open_photograph(path)
    values = photograph.values
    height, width = values.shape[:2]
    if height * width > _LARGEST:
        megapixels = height * width / 1e6
        raise FileFormatError(
            f"{path.name}: the image has {megapixels:.0f} megapixels, but at most {_LARGEST // 10**6} can be shown: crop the "
            "image"
        )
    shown, step = drawn_values(values, linear=photograph.linear)
    kind = f"mosaic {photograph.cfa}" if photograph.cfa else "colour" if values.ndim == 3 else "grey"
    codes = "linear values" if photograph.linear else f"codes of {values.dtype.itemsize * 8} bits"
    thinned = f"; one of {step} pixels along each side is drawn" if step > 1 else ""
    return OpenedPicture(path, photograph, shown, f"{path.name}: {width} x {height} px, {kind}, {codes}{thinned}")


def drawn_values(values: np.ndarray, *, linear: bool) -> tuple[np.ndarray, int]:
    """Convert an image for display, and return the subsampling step, px.

    The displayed image is grey, from 0 to 1, subsampled, and encoded for a screen.

    Args:
        values: (height, width) or (height, width, channel).
        linear: True if the values are proportional to the light.
    """
    # the page receives at most 1200 pixels along a side; larger images are subsampled
    step = max(1, -(-max(values.shape[:2]) // 1200))
    few = np.nan_to_num(np.asarray(values[::step, ::step], dtype=np.float32))
    grey = few.mean(axis=-1) if few.ndim == 3 else few
    low, high = np.quantile(grey, (0.001, 0.999))
    shown = np.clip((grey - low) / max(float(high - low), 1e-12), 0, 1)
    return (shown ** (1 / 2.2) if linear else shown), step


def measured_edge(
    picture: OpenedPicture, region: tuple[int, int, int, int] | None, tone: str, half_width: float
) -> Any:
    """Measure the MTF across an edge as `matcam edge` does.

    `region` contains x, y, width and height of the region with the edge, px; None: the entire image. `half_width` is the
    half width of a pixel, px.
    """
    from matcam.calibration.edge.edge import edge_mtf

    return edge_mtf(picture.photograph, region, tone=tone, half_width=half_width)


def calibrated(paths: Sequence[Path], model: str, tone: str, half_width: float, chart: Path | None = None) -> Any:
    """Calibrate the camera of these images as `matcam calibrate` does.

    `half_width` is the half width of a pixel, px. `chart` is the file with the description of the chart in the images.
    Default: None, edges are found automatically.
    """
    from matcam.calibration.camera.calibration import calibrate

    return calibrate(list(paths), model=model, tone=tone, half_width=half_width, chart=chart)


def is_chart(path: Path) -> bool:
    from matcam.files.formats import identify

    try:
        return path.suffix.lower() == ".json" and is_file(path) and identify(path) == "chart"
    except MatcamError:
        return False


def about_chart(path: Path) -> str:
    """Describe the targets of a chart by the number and name of each kind.

    Raises:
        FileFormatError: the file is not the description of a chart.
    """
    from matcam.calibration.chart.chart_file import read_chart

    kinds = [type(element).__name__.lower() for element in read_chart(path).elements]
    return ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))


def targets_in(picture: OpenedPicture, chart: Path, tone: str, half_width: float, channel: str) -> list[Any]:
    """Measure the gratings, stars and dots of a chart in an image.

    Returns:
        MTF samples; an empty list if the chart is not found in the image.
    """
    from matcam.calibration.chart.chart_file import read_chart
    from matcam.calibration.photograph.linear_image import planes_of
    from matcam.calibration.targets.targets import measure_targets

    (plane,) = planes_of(picture.photograph, [channel], tone, None, picture.path.name)
    try:
        return list(measure_targets(plane, read_chart(chart), half_width=half_width).samples)
    except FitError:
        return []


def target_columns(samples: Sequence[Any]) -> dict[str, list[Any]]:
    """Tabulate position (px), kind and one MTF sample of each target.

    The frequency (cycles/px) of this sample is that at which the MTF is nearest to 0.5.
    """
    nearest = [int(np.argmin(np.abs(one.mtf - 0.5))) for one in samples]
    return {
        "x": [one.position[0] for one in samples],
        "y": [one.position[1] for one in samples],
        "kind": [one.kind for one in samples],
        "frequency": [float(one.frequency[k]) for one, k in zip(samples, nearest, strict=True)],
        "mtf": [float(one.mtf[k]) for one, k in zip(samples, nearest, strict=True)],
        "mtf_std": [float(one.mtf_std[k]) for one, k in zip(samples, nearest, strict=True)],
    }


def edges_in(found: Any, picture: OpenedPicture) -> dict[str, Any]:
    """Tabulate the edges in one image for the main channel.

    Returns:
        `x`, `y`: middle of each edge, px. `x0`, `y0`, `x1`, `y1`: ends of a short line along the edge, px. `mtf50`,
        `mtf50_std`: cycles/px.
    """
    data = found.edges_dataset()
    here = (data["channel"].values == found.channel) & (data["picture"].values == _source(found, picture.path))
    one = data.isel(edge=np.flatnonzero(here))
    x, y, angle = (one[name].values for name in ("x", "y", "angle"))
    half = 20.0  # half the length of the line, px
    along_x, along_y = -np.sin(angle) * half, np.cos(angle) * half
    return {
        "x": x, "y": y, "x0": x - along_x, "x1": x + along_x, "y0": y - along_y, "y1": y + along_y,
        "mtf50": one["mtf50"].values, "mtf50_std": one["mtf50_std"].values,
    }  # fmt: skip


def _source(found: Any, path: Path) -> str:
    return next((name for name in found.pictures if name in (str(path), path.name)), str(path))


def profiles(found: Any) -> dict[str, bytes]:
    cameras = {"camera.json": found.camera}
    if len(found.channels) > 1:
        cameras |= {f"camera-{name}.json": camera for name, camera in found.cameras.items()}
    return {name: json_text(camera.profile()).encode(errors="backslashreplace") for name, camera in cameras.items()}


def opened_or_why(path: Path) -> OpenedPicture | tuple[Path, str] | MatcamError:
    """Open an image or the description of a chart.

    Returns:
        The image, or the path and the description of the targets of a chart. If the file cannot be opened, the error is
        returned.
    """
    try:
        return (path, about_chart(path)) if path.suffix.lower() == ".json" else open_picture(path)
    except MatcamError as error:
        return error
