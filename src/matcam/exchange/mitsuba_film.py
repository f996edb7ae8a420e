"""Camera for a Mitsuba rendering: the effective kernel as a differentiable linear operation of Dr.Jit.

Mitsuba renders radiance on a film with a box filter, with several subpixels per pixel. The value of a pixel of the
camera is a weighted sum of the subpixels. Each weight is the integral of the kernel over the subpixel, so the radiance
is assumed to be constant within a subpixel. The operation is linear. Its forward derivative is therefore the same
operation, and its backward derivative is the transpose.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.signal import fftconvolve

from matcam.camera.camera import Camera
from matcam.core import checks
from matcam.core.errors import ArgumentError

_FARTHEST = 32
"""Largest support radius, px: the kernel then has a width of 65 px."""


class MitsubaFilm:
    """Film that converts a rendering to the record of a camera.

    Args:
        camera: lens and pixel; its effective kernel is applied.
        subpixels: number of subpixels of the rendering along each side of a pixel, no unit, 1 to 16. Default: 4.
        reach: support radius of the kernel, px, a whole number from 1 to 256. Default: None, the radius that contains
            99.9 % of the line spread function, at most 32 px.

    Raises:
        ArgumentError: the kernel of the camera differs between colours or positions, or an argument is out of range.

    Example:
        >>> film = matcam.exchange.MitsubaFilm(matcam.Camera(matcam.GaussianOptics(0.5)), subpixels=2)
        >>> film.record(np.ones((40, 60, 3)))[10, 15].round(6)
        array([1., 1., 1.])
    """

    def __init__(self, camera: Camera, subpixels: int = 4, reach: int | None = None):
        if not isinstance(camera, Camera):
            raise ArgumentError(f"camera must be a Camera, got {type(camera).__name__}")
        checks.whole_number("subpixels", subpixels, 1, 16)
        checks.whole_number("reach", reach, 1, 256, unit="px", optional=True)
        self.subpixels = subpixels
        self.reach = _reach(camera) if reach is None else reach
        weights = _weights(camera, subpixels, self.reach)
        self.weights = weights / weights.sum()

    def record(self, image: np.ndarray) -> np.ndarray:
        """Compute the record of a rendering by the camera.

        The surroundings of the rendering are treated as dark: render `reach` additional pixels on every side, and crop.

        Args:
            image: radiance of the subpixels, (rows, columns) or (rows, columns, channels). Rows and columns are
                multiples of `subpixels`.

        Returns:
            Radiance of the pixels, (rows / subpixels, columns / subpixels) and the channels, if any.

        Raises:
            ArgumentError: the image has another number of axes, is empty, or does not consist of whole pixels.
        """
        image = np.asarray(image, np.float64)
        s = self.subpixels
        if image.ndim not in (2, 3) or image.shape[0] % s or image.shape[1] % s or 0 in image.shape:
            raise ArgumentError(
                f"image must have axes (rows, columns) or (rows, columns, channels), not be empty, and have {s} x {s} "
                f"subpixels for each pixel, got shape {image.shape}"
            )
        margin = self.reach * s
        padded = np.pad(image, [(margin, margin)] * 2 + [(0, 0)] * (image.ndim - 2))
        kernel = self._kernel(image.ndim)[::-1, ::-1]
        return np.asarray(fftconvolve(padded, kernel, "valid", axes=(0, 1))[::s, ::s])

    def adjoint(self, picture: np.ndarray) -> np.ndarray:
        """Apply the transpose of `record`, from pixels to subpixels.

        Args:
            picture: derivative with respect to each pixel, (rows, columns) or (rows, columns, channels).

        Returns:
            Derivative with respect to each subpixel.
        """
        picture = np.asarray(picture, np.float64)
        s, margin = self.subpixels, self.reach * self.subpixels
        rows, columns = picture.shape[0] * s, picture.shape[1] * s
        spread = np.zeros((rows - s + 1, columns - s + 1, *picture.shape[2:]))
        spread[::s, ::s] = picture
        whole = fftconvolve(spread, self._kernel(picture.ndim), "full", axes=(0, 1))
        return np.asarray(whole[margin : margin + rows, margin : margin + columns])

    def __call__(self, image: Any) -> Any:
        """Compute the record as a differentiable operation of Dr.Jit.

        Args:
            image: tensor of the subpixels, as `mitsuba.render` returns it.

        Returns:
            Tensor of the pixels, of the same type.

        Raises:
            ArgumentError: the image has another number of axes, is empty, or does not consist of whole pixels.
        """
        import drjit as dr

        film, kind = self, type(image)

        class Recorded(dr.CustomOp):
            """Operation of Dr.Jit with its forward and backward derivatives."""

            def eval(self, image: Any) -> Any:
                return kind(film.record(np.array(image)).astype(np.float32))

            def forward(self) -> None:
                self.set_grad_out(kind(film.record(np.array(self.grad_in("image"))).astype(np.float32)))

            def backward(self) -> None:
                self.set_grad_in("image", kind(film.adjoint(np.array(self.grad_out())).astype(np.float32)))

        return dr.custom(Recorded, image)

    def _kernel(self, dimensions: int) -> np.ndarray:
        return self.weights if dimensions == 2 else self.weights[..., None]


def _reach(camera: Camera) -> int:
    """Compute the smallest support radius that contains 99.9 % of the line spread function, px.

    The radius is at most 32 px.
    """
    distance = np.arange(1, _FARTHEST + 1)
    enclosed = np.asarray(camera.esf(distance + 0.5)) - np.asarray(camera.esf(-distance - 0.5))
    # the support contains 99.9 % of the kernel; the weights within it are scaled to a sum of 1
    enough = np.flatnonzero(enclosed >= 0.999)
    return int(distance[enough[0]]) if enough.size else _FARTHEST


def _weights(camera: Camera, subpixels: int, reach: int) -> np.ndarray:
    """Integrate the effective kernel over each subpixel; rows increase downwards, as in an image."""
    nodes, of_nodes = np.polynomial.legendre.leggauss(2)
    count = (2 * reach + 1) * subpixels
    centre = (np.arange(count) + 0.5) / subpixels - (reach + 0.5)
    at = (centre[:, None] + nodes / (2 * subpixels)).ravel()
    weights = np.tile(of_nodes / (2 * subpixels), count)
    if camera.optics.isotropic:  # the other quadrants are mirror images of the first one
        half = at[: at.size // 2]
        x, y = np.meshgrid(half, -half)
        quadrant = np.asarray(camera.psf(x, y))
        upper = np.concatenate([quadrant, quadrant[:, ::-1]], axis=1)
        values = np.concatenate([upper, upper[::-1]])
    else:
        x, y = np.meshgrid(at, -at)
        values = np.asarray(camera.psf(x, y))
    values = values * weights * weights[:, None]
    return values.reshape(count, nodes.size, count, nodes.size).sum((1, 3))
