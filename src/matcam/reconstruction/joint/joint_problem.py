"""Problem of the joint fit of all images: parameters, pixels, model with derivatives, and prior (docs/model.md 10).

The model of pixel i of channel c in image k is

    exp(g_k) [F_kc (1 + slope (theta_i - theta_k)) lobe_i + diffuse_c lambert_i]

F_kc is the strength of the lobe, which is free in every image. g_k is the logarithm of the gain, which has a prior. theta_i
is the difference angle of the pixel, theta_k is the angle to which F_kc applies, and slope is d ln F / d theta_d. lobe_i and
lambert_i are the records of a lobe with F = 1 and of a diffuse part of albedo 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from matcam.reconstruction.joint.field_change import FIELD, STEP, FieldChange
from matcam.reconstruction.observed_pixels import ObservedPixels
from matcam.reconstruction.picture_model import OWN, SCENE, LampFrame, Recorded


class JointLayout(NamedTuple):
    """Order of all parameters: shared parameters, then own parameters, gain and strengths of each image.

    The shared parameters are lobe, scene, diffuse parts, lens field, sample radius and diffuse shape.

    Attributes:
        lobe: number of parameters of the lobe.
        channels: number of channels.
        pictures: number of images.
        shape: number of terms by which the diffuse part departs from Lambert's law. Default: 0.
    """

    lobe: int
    channels: int
    pictures: int
    shape: int = 0

    @property
    def shared(self) -> int:
        return self.sample_radius + 1 + self.shape

    @property
    def each(self) -> int:
        return len(OWN) + 1 + self.channels

    @property
    def size(self) -> int:
        return self.shared + self.pictures * self.each

    @property
    def scene(self) -> slice:
        """Indices of lens, radius and inverse distances."""
        return slice(self.lobe, self.lobe + len(SCENE))

    def of(self, name: str) -> int:
        return self.lobe + SCENE.index(name)

    @property
    def diffuse(self) -> slice:
        return slice(self.scene.stop, self.scene.stop + self.channels)

    @property
    def field(self) -> slice:
        """Indices of the differences of the lens field from its profile."""
        return slice(self.diffuse.stop, self.diffuse.stop + len(FIELD))

    @property
    def rig(self) -> list[int]:
        """Indices of the parameters of the rig that precede those of the lamps, in the order of `SCENE_NAMES`."""
        return [*map(self.of, ("lens", "camera", "lamp")), *range(self.field.start, self.field.stop)]

    @property
    def sample_radius(self) -> int:
        """Index of ln of the ratio of the sample radius to its specified value.

        The ratio scales distances that are specified in mm.
        """
        return self.field.stop

    @property
    def diffuse_shape(self) -> slice:
        return slice(self.sample_radius + 1, self.shared)

    def shared_of(self, p: np.ndarray, other: JointLayout) -> np.ndarray:
        """Arrange the shared parameters of another order, (shared,). Parameters that it lacks are 0.

        Args:
            p: parameters in the other order, (other.size,).
            other: the other order.
        """
        found = np.zeros(self.shared)
        common = min(self.lobe, other.lobe)
        found[:common] = p[:common]
        found[self.scene.start : self.sample_radius + 1] = p[other.scene.start : other.sample_radius + 1]
        if self.shape and other.shape:
            found[self.diffuse_shape] = p[other.diffuse_shape]
        return found

    def own(self, k: int) -> slice:
        """Return the indices of the parameters `OWN` of an image: centre and rotations of the lamp."""
        first = self.shared + k * self.each
        return slice(first, first + len(OWN))

    def centre(self, k: int) -> slice:
        """Return the indices of column and row of the centre of an image."""
        return slice(self.own(k).start, self.own(k).start + 2)

    def turn(self, k: int) -> slice:
        """Return the indices of the two rotations of the lamp of an image."""
        return slice(self.own(k).start + 2, self.own(k).stop)

    def gain(self, k: int) -> int:
        """Return the index of ln of the gain of an image."""
        return self.own(k).stop

    def strengths(self, k: int) -> slice:
        first = self.gain(k) + 1
        return slice(first, first + self.channels)

    def of_picture(self, k: int) -> np.ndarray:
        return np.r_[: self.scene.stop, self.diffuse_shape, self.own(k)]


class PixelModel(Protocol):
    """Model of pixels at unit strengths, with derivatives with respect to the parameters of one image."""

    def window(self, p: np.ndarray, frame: LampFrame, window: Any, *, slopes: bool) -> tuple[Recorded, Recorded | None]:
        """Compute the record of the window about the highlight, with two pixel axes, and its derivatives.

        The derivatives have an additional last axis over the parameters. They are None if `slopes` is False.
        """

    def pixels(
        self, p: np.ndarray, frame: LampFrame, column: np.ndarray, row: np.ndarray, *, slopes: bool
    ) -> tuple[Recorded, Recorded | None]:
        """Compute the record of single pixels, (pixels,), and its derivatives, (pixels, parameters).

        The derivatives are None if `slopes` is False.
        """


@dataclass(frozen=True)
class JointProblem:
    """Images, model and prior of a joint fit.

    Attributes:
        model: model of the pixels.
        layout: order of the parameters.
        pixels: chosen pixels of each image.
        frames: base direction of the lamp of each image.
        prior_rows: linear combinations of the parameters with a prior of standard deviation 1, (rows, size).
        prior_values: prior means of these combinations, (rows,).
        prior_sources: source of each row: "lens", "outline", "lamp", "gain", ...
        low: smallest value of each parameter.
        high: largest value of each parameter.
        slope: d ln F / d theta_d of each image and channel, 1/rad, (pictures, channels).
        fixed: True for parameters that are constant, (size,).
        changes: effect of a change of the lens field on each image. Default: (), the lens has no field.
        unstated: effect of an unspecified distortion on each image. The distortion is not fitted, but is included in the
            covariance. Default: (), there is no unspecified distortion.
    """

    model: PixelModel
    layout: JointLayout
    pixels: Sequence[ObservedPixels]
    frames: Sequence[LampFrame]
    prior_rows: np.ndarray
    prior_values: np.ndarray
    prior_sources: tuple[str, ...]
    low: np.ndarray
    high: np.ndarray
    slope: np.ndarray
    fixed: np.ndarray
    changes: Sequence[FieldChange] = ()
    unstated: Sequence[FieldChange] = ()

    @property
    def judged(self) -> np.ndarray:
        """Mask of the uncertain parameters: those that are fitted, and an unspecified distortion."""
        judged = ~self.fixed
        judged[self.layout.field.start] |= len(self.unstated) > 0
        return judged

    def information_of(self, source: str) -> np.ndarray:
        """Return the prior information matrix of one source, (size, size)."""
        rows = self.prior_rows[[one == source for one in self.prior_sources]]
        return rows.T @ rows

    def recorded(self, p: np.ndarray, k: int, *, slopes: bool) -> tuple[Recorded, Recorded | None]:
        """Compute the record of the pixels of image k at unit strengths, and its derivatives.

        The pixels of the window precede the scattered pixels. The derivatives are None if `slopes` is False.
        """
        at, pixels, frame = p[self.layout.of_picture(k)], self.pixels[k], self.frames[k]
        window, column, row = pixels.window, pixels.column, pixels.row
        beside = at
        if self.changes:
            window = self.changes[k].window(window, p[self.layout.field])
            column, row = self.changes[k].positions(p[self.layout.field])
            # blur matters only near the highlight, so the blur at the highlight is used
            beside = at.copy()
            beside[self.layout.lobe] += np.log(window.widened)
        near, near_slopes = self.model.window(at, frame, window, slopes=slopes)
        far, far_slopes = self.model.pixels(beside, frame, column, row, slopes=slopes)

        def joined(first: np.ndarray, second: np.ndarray) -> np.ndarray:
            first = np.asarray(first)
            return np.concatenate([first.reshape(-1, *first.shape[2:]), np.asarray(second)])

        value = Recorded(*map(joined, near, far))
        if near_slopes is None or far_slopes is None:
            return value, None
        return value, Recorded(*map(joined, near_slopes, far_slopes))

    def picture(self, p: np.ndarray, k: int, *, slopes: bool) -> PictureFit:
        layout, pixels = self.layout, self.pixels[k]
        recorded, derivative = self.recorded(p, k, slopes=slopes)
        channel = pixels.channel
        strength, diffuse = p[layout.strengths(k)][channel], p[layout.diffuse][channel]
        gain = np.exp(p[layout.gain(k)])
        peak = int(np.argmax(np.where(pixels.used, recorded.lobe, -1.0)))
        theta = recorded.theta_d[peak]
        slope = self.slope[k][channel]
        tilt = 1 + slope * (recorded.theta_d - theta)
        lobe, lambert = strength * tilt * recorded.lobe, diffuse * recorded.lambert
        value = gain * (lobe + lambert)
        if derivative is None:
            return PictureFit(value, None, theta, None)
        jacobian = np.zeros((value.size, layout.size))
        columns = layout.of_picture(k)
        by_theta = derivative.theta_d - derivative.theta_d[peak]
        jacobian[:, columns] = gain * (
            (strength * tilt)[:, None] * derivative.lobe
            + (strength * slope * recorded.lobe)[:, None] * by_theta
            + diffuse[:, None] * derivative.lambert
        )
        angle = np.zeros(layout.size)
        angle[columns] = derivative.theta_d[peak]
        if self.changes:
            of_k1, of_growth = layout.field.start, layout.field.start + 1
            change, wider = p[layout.field], self.changes[k].widening(p[layout.field])
            jacobian[:, of_growth] = jacobian[:, layout.lobe] * wider
            angle[of_growth] = angle[layout.lobe] * wider
            window = self.changes[k].window(pixels.window, change + np.array([STEP, 0.0]))
            moved, _ = self.model.window(p[columns], self.frames[k], window, slopes=False)
            near = slice(0, window.pixel_u.size * window.pixel_v.size)
            by_k1 = Recorded(*((np.asarray(a).ravel() - b[near]) / STEP for a, b in zip(moved, recorded, strict=True)))
            angle[of_k1] = by_k1.theta_d[peak] if peak < near.stop else 0.0
            jacobian[near, of_k1] = gain * (
                (strength * tilt)[near] * by_k1.lobe
                + (strength * slope * recorded.lobe)[near] * (by_k1.theta_d - angle[of_k1])
                + diffuse[near] * by_k1.lambert
            )
            # a shift of a pixel has the effect of an opposite shift of the sphere
            far, centre = slice(near.stop, None), layout.centre(k)
            away = self.changes[k].positions_slopes(change).T
            jacobian[far, of_k1] = -(jacobian[far, centre] * away).sum(axis=1)
        jacobian[:, layout.gain(k)] = value
        everything = np.arange(value.size)
        jacobian[everything, layout.strengths(k).start + channel] = gain * tilt * recorded.lobe
        jacobian[everything, layout.diffuse.start + channel] = gain * recorded.lambert
        return PictureFit(value, jacobian, float(theta), angle)


class PictureFit(NamedTuple):
    """Model of the chosen pixels of one image.

    Attributes:
        value: model of the pixels, (pixels,).
        jacobian: derivatives of the model, (pixels, parameters); None: not requested.
        theta_d: angle to which the strengths apply, rad.
        theta_d_slope: derivatives of `theta_d`, (parameters,); None: not requested.
    """

    value: np.ndarray
    jacobian: np.ndarray | None
    theta_d: float
    theta_d_slope: np.ndarray | None
