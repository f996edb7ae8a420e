"""What the calibrate view shows of photographs, and what it measures in them."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from matcam.core.errors import FileFormatError, MatcamError

_LARGEST = 120_000_000
"""Most pixels of a picture that is shown."""
_ON_SCREEN = 1200
"""Most pixels along a side of what is sent to the page; more are left out evenly."""


@dataclass(frozen=True)
class OpenedPicture:
    """A photograph, and how it is drawn.

    Attributes:
        path: its file.
        photograph: its values.
        shown: its pixels as they lie in the file, thinned for the page, 0 to 1, encoded for a screen.
        about: what it is, and what is taken for its tone curve.
    """

    path: Path
    photograph: Any
    shown: np.ndarray
    about: str

    @property
    def size(self) -> tuple[int, int]:
        """Return (height, width), px."""
        height, width = self.photograph.values.shape[:2]
        return height, width


def open_picture(path: Path) -> OpenedPicture:
    """Read a photograph.

    Raises:
        FileFormatError: it is missing, damaged, of no known format, or too large.
    """
    from matcam.files.photographs import open_photograph

    photograph = open_photograph(path)
    values = photograph.values
    height, width = values.shape[:2]
    if height * width > _LARGEST:
        megapixels = height * width / 1e6
        raise FileFormatError(
            f"{path.name}: {megapixels:.0f} megapixels: a part of at most {_LARGEST // 10**6} can be shown"
        )
    step = max(1, -(-max(height, width) // _ON_SCREEN))
    few = np.nan_to_num(np.asarray(values[::step, ::step], dtype=np.float32))
    grey = few.mean(axis=-1) if few.ndim == 3 else few
    low, high = np.quantile(grey, (0.001, 0.999))
    shown = np.clip((grey - low) / max(float(high - low), 1e-12), 0, 1)
    if photograph.linear:
        shown = shown ** (1 / 2.2)
    kind = f"mosaic {photograph.cfa}" if photograph.cfa else "colour" if values.ndim == 3 else "grey"
    codes = "linear by its format" if photograph.linear else f"codes of {values.dtype.itemsize * 8} bits"
    thinned = f"; every {step}th pixel is drawn" if step > 1 else ""
    return OpenedPicture(path, photograph, shown, f"{path.name}: {width} x {height} px, {kind}, {codes}{thinned}")


def measured_edge(
    picture: OpenedPicture, region: tuple[int, int, int, int] | None, tone: str, half_width: float
) -> Any:
    """Return the MTF across the edge in a region (x, y, width, height), px, as `matcam edge` measures it."""
    from matcam.calibration.edge.edge import edge_mtf

    return edge_mtf(picture.photograph, region, tone=tone, half_width=half_width)


def calibrated(paths: Sequence[Path], model: str, tone: str, half_width: float) -> Any:
    """Return the camera of these pictures, as `matcam calibrate` finds it."""
    from matcam.calibration.camera.calibration import calibrate

    return calibrate(list(paths), model=model, tone=tone, half_width=half_width)


def edges_in(found: Any, picture: OpenedPicture) -> dict[str, Any]:
    """Return the edges that a calibration measured in a picture, of its main channel, as columns.

    Returns:
        `x`, `y` of an edge's middle, `x0`, `y0`, `x1`, `y1` of a short line along it, px, `mtf50` and `mtf50_std`, cycles/px.
    """
    data = found.edges_dataset()
    here = (data["channel"].values == found.channel) & (data["picture"].values == _source(found, picture.path))
    one = data.isel(edge=np.flatnonzero(here))
    x, y, angle = (one[name].values for name in ("x", "y", "angle"))
    along_x, along_y = -np.sin(angle) * _HALF_LINE, np.cos(angle) * _HALF_LINE
    return {
        "x": x, "y": y, "x0": x - along_x, "x1": x + along_x, "y0": y - along_y, "y1": y + along_y,
        "mtf50": one["mtf50"].values, "mtf50_std": one["mtf50_std"].values,
    }  # fmt: skip


_HALF_LINE = 20.0  # px


def _source(found: Any, path: Path) -> str:
    """Return the name under which a calibration knows a picture."""
    return next((name for name in found.pictures if name in (str(path), path.name)), str(path))


def profiles(found: Any) -> dict[str, bytes]:
    """Return the files that `matcam calibrate` would write for the cameras, by name."""
    cameras = {"camera.json": found.camera}
    if len(found.channels) > 1:
        cameras |= {f"camera-{name}.json": camera for name, camera in found.cameras.items()}
    with tempfile.TemporaryDirectory(prefix="matcam-app-") as folder:
        for name, camera in cameras.items():
            camera.save(Path(folder) / name)
        return {name: (Path(folder) / name).read_bytes() for name in cameras}


def opened_or_why(path: Path) -> OpenedPicture | MatcamError:
    """Return a picture, or why it cannot be shown."""
    try:
        return open_picture(path)
    except MatcamError as error:
        return error
