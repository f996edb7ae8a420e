"""Checks of a capture of a cylinder: directions of the lamps, and rows of the strips."""

from __future__ import annotations

from matcam.acquisition.check.flat_check import direction_remarks
from matcam.acquisition.mosaic_frames import frame_size
from matcam.core.remark import Remark
from matcam.files.capture import Capture


def cylinder_remarks(capture: Capture) -> list[Remark]:
    """Report unknown directions, which a cylinder does not show, and strips beyond the frames.

    Args:
        capture: capture of a cylinder.
    """
    found, size = direction_remarks(capture), frame_size(capture)
    for number, (first, last) in enumerate(capture.settings["sample"]["strip_rows_px"] or (), 1):
        if size is not None and last >= size[1]:
            text = (
                f"strip {number} has the rows {first} to {last}, but the frames have the rows 0 to {size[1] - 1}: correct "
                "sample.strip_rows_px"
            )
            found.append(Remark("strip-outside", text))
    return found
