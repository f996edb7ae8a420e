"""Detection of a clipped bright field, and correction of the radius for the part of the sample that the field hides."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from matcam.core.remark import Remark


def field_is_clipped(codes: np.ndarray, saturation: float) -> bool:
    """Detect a clipped bright field.

    Many pixels of a clipped field have the largest code of the frame. In addition, this code is the largest that the
    file can hold, or the dark pixels of the frame show noise. A frame without noise is a render. The uniform field of a
    render has a single code without clipping.

    Args:
        codes: frame of the sample in front of a bright field, (height, width), DN.
        saturation: largest code that the file can hold, DN.
    """
    top = float(codes.max())
    # without clipping, noise brings only a few pixels of a frame to its largest code
    if np.mean(codes == top) < 0.05:
        return False
    dark = codes < np.percentile(codes, 20)
    pairs = dark[:, 1:] & dark[:, :-1]
    return top >= saturation or (bool(pairs.any()) and bool(np.mean(codes[:, 1:][pairs] == codes[:, :-1][pairs]) < 0.9))


def hidden_by_clipping(path: Path, sigma: float) -> tuple[float, Remark]:
    """Compute the apparent shrinkage of the sample by a clipped field, px, and build a remark.

    The blurred edge of a field of brightness B has the value B / 2 at the true edge. If the field is clipped at C, the edge
    appears where the value is C / 2. This position is a distance s z inside the true edge. Here s is the standard deviation
    of the blur of lens and pixel, and z is the normal quantile of 1 - C / (2 B). If B is 1 to 10 times C, z is 0 to 1.6. The
    shrinkage is computed with the middle value, z = 0.8. Its standard deviation is assumed to be equal to the shrinkage.

    Args:
        path: path of the frame or the frames, for the remark.
        sigma: standard deviation of the lens's blur, px.
    """
    # the response of a full pixel has a standard deviation of 1 / sqrt(12) px
    middle = 0.8 * float(np.hypot(sigma, 0.29))
    return middle, Remark(
        "outline-clipped",
        f"{path}: the bright field is clipped, which hides {middle:.1f} ± {middle:.1f} px of the radius; expose outline "
        "frames less",
    )
