"""Outline of a sphere in an image: centre and radius of the limb, corrected for the blur of the lens, with covariance.

The image shows a sphere that a lamp lights up to the limb, or a dark sphere in front of a bright field. The edges of the
limb are measured in sectors of azimuth (`limb/limb_edges.py`). The outline is the image of a sphere at a known distance: a
circle if the sphere is on the camera's axis, and an ellipse otherwise. Sectors with a stand, dust or a highlight are
omitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, get_args

import numpy as np
from scipy.optimize import minimize_scalar

from matcam.acquisition.limb.backlight import grazing_reflection
from matcam.acquisition.limb.circle_search import FoundCircle, find_circles
from matcam.acquisition.limb.limb_edges import BandPixels, LimbSectors, blurred_powers, sector_edges
from matcam.acquisition.merged_picture import MergedPicture
from matcam.acquisition.mirror_ball import MirrorBall
from matcam.core.errors import ArgumentError, FitError
from matcam.core.remark import Remark
from matcam.numerics.normal import robust_std

LimbLight = Literal["lit", "backlit"]
EXPONENTS: dict[str, tuple[float, ...]] = {"lit": (0, 0.5, 1), "coated": (0, 0.5, 1), "backlit": (0, 1)}
"""Exponents of the distance inside the limb in the model of its light; the cosine of the viewing angle has exponent 0.5.
"coated" includes the transmittance of a clear coat, as on glossy plastic; a lit sphere is fitted with both models."""

_SIGMAS = (0.05, 0.2, 0.5, 0.9, 1.6, 2.5)  # initial values of the standard deviation of an unmeasured blur, px
_CONTRAST = 8.0  # smallest ratio of the step of light to its noise
_TEMPER = 15.0
"""Difference in chi squared for a likelihood ratio of e between two models of the light. It is 2 for exact models."""
_SIMPLER = 30.0
"""Decrease of chi squared with a coat below which a sphere is treated as uncoated."""
FEWEST_SECTORS = 8


class Sighting(NamedTuple):
    """Geometry of the camera relative to the sphere.

    Attributes:
        distance: distance of the camera from the sphere's centre, radii; infinite for an orthographic camera. Default:
            infinite.
        axis: (row, column) of the intersection of the optical axis with the frame, px. Default: None, the image of the
            sphere's centre.
    """

    distance: float = np.inf
    axis: tuple[float, float] | None = None

    def radius_at(self, azimuth: np.ndarray, row: float, column: float, radius: float) -> np.ndarray:
        """Compute the distance of the limb from the image of the centre along an azimuth, px.

        Args:
            azimuth: azimuth, from +column towards +row, rad.
            row: row of the image of the sphere's centre, px.
            column: column of the image of the sphere's centre, px.
            radius: radius that the limb would have if the sphere's centre were on the optical axis, px.
        """
        if self.axis is None or np.isinf(self.distance):
            return np.full(np.shape(azimuth), radius)
        focal = radius * np.sqrt(self.distance**2 - 1)
        centre = np.array([column - self.axis[1], row - self.axis[0], focal])
        centre /= np.linalg.norm(centre)
        first = np.array([centre[2], 0.0, -centre[0]]) / np.hypot(centre[0], centre[2])
        second = np.cross(centre, first)
        turn = np.linspace(0, 2 * np.pi, 721)[:-1, None]
        edge = centre * np.sqrt(1 - self.distance**-2) + (np.cos(turn) * first + np.sin(turn) * second) / self.distance
        x, y = focal * (edge[:, :2] / edge[:, 2:] - centre[:2] / centre[2]).T
        angle, length = np.arctan2(y, x), np.hypot(x, y)
        order = np.argsort(angle)
        return np.interp(azimuth, angle[order], length[order], period=2 * np.pi)


@dataclass(frozen=True)
class Outline:
    """Outline of a sphere in the frame.

    Attributes:
        row: row of the image of the sphere's centre, px; rows increase downwards, pixel centres are integers.
        column: column of the image of the sphere's centre, px.
        radius: radius that the limb would have if the sphere's centre were on the optical axis, px.
        covariance: covariance of (row, column, radius), px^2 (3, 3), due to noise, scatter of the edges, and uncertainties
            of the lens and of the light near the limb.
        sigma: standard deviation of the lens's blur, px.
        sigma_std: standard deviation of `sigma`, px.
        sighting: geometry of the camera relative to the sphere.
        sectors: measured edges, one for each sector.
        used: mask of the edges that are used for the outline.
        scatter: rms distance of the used edges from the outline, px.
        noise: part of `covariance` that is due to noise and scatter, px^2 (3, 3).
        coated: True if the light near the limb is that of a sphere under a clear coat.
        remarks: warnings and limitations.
    """

    row: float
    column: float
    radius: float
    covariance: np.ndarray
    sigma: float
    sigma_std: float
    sighting: Sighting
    sectors: LimbSectors
    used: np.ndarray
    scatter: float
    noise: np.ndarray
    coated: bool = False
    remarks: tuple[Remark, ...] = ()

    @property
    def std(self) -> np.ndarray:
        """Standard deviations of row, column and radius, px (3,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def ball(self) -> MirrorBall:
        return MirrorBall(self.row, self.column, self.radius, self.sighting.distance, self.sighting.axis)

    def curve(self, azimuth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute rows and columns of the outline, px, for an overlay.

        Args:
            azimuth: from +column towards +row, rad.
        """
        length = self.sighting.radius_at(azimuth, self.row, self.column, self.radius)
        return self.row + length * np.sin(azimuth), self.column + length * np.cos(azimuth)


def stacked(pictures: Sequence[MergedPicture]) -> MergedPicture:
    """Average several images, so that all lamps together light the whole limb.

    Args:
        pictures: images of one sphere at one position. All images must have the same shape and origin.

    Returns:
        The mean image. Each pixel is the mean over the images in which the pixel has a value. A pixel is marked as clipped
        if it is clipped in any image.

    Raises:
        ArgumentError: there is no image, or the images differ in shape or origin.
    """
    shapes = {(one.values.shape, one.origin) for one in pictures}
    if len(shapes) != 1:
        raise ArgumentError(
            f"pictures must have the same shape and the same origin, got {len(shapes)} different combinations"
        )
    number, total, variance = (np.zeros(pictures[0].values.shape) for _ in range(3))
    clipped = np.zeros(pictures[0].values.shape, bool)
    for one in pictures:
        good = np.isfinite(one.values)
        number += good
        total += np.where(good, one.values, 0.0)
        variance += np.where(good, one.std, 0.0) ** 2
        clipped |= one.clipped
    some = np.maximum(number, 1)
    nothing = np.where(number > 0, 0.0, np.nan)
    return replace(
        pictures[0],
        name="all lamps",
        values=total / some + nothing,
        std=np.sqrt(variance) / some + nothing,
        clipped=clipped,
    )


def find_outline(
    picture: MergedPicture,
    *,
    light: LimbLight = "lit",
    sighting: Sighting | None = None,
    backlight_reach: tuple[float, float] | None = None,
) -> Outline:
    """Find the outline of the sphere in an image.

    Args:
        picture: image of one lamp or of all lamps (`stacked`), or a frame with light from behind.
        light: "lit" for a sphere brighter than its background, "backlit" for a dark sphere in front of a bright field.
        sighting: geometry of the camera. Default: infinitely distant.
        backlight_reach: angle by which the bright field extends beyond the limb, and the standard deviation of this angle,
            rad. The sphere mirrors the field. Default: unknown; the error includes the reflection of a field of 3 degrees.

    Returns:
        The outline, in px of the frame.

    Raises:
        ArgumentError: `light` is unknown.
        FitError: the image shows no sphere or two spheres, the frame cuts the sphere, or too little of the limb is visible
            against the background.

    Source:
        docs/outline.md.
    """
    if light not in get_args(LimbLight):
        raise ArgumentError(f"light must be one of {', '.join(map(repr, get_args(LimbLight)))}, got {light!r}")
    sighting = sighting or Sighting()
    begin = np.array(_searched(picture, light))
    found = []
    for kind in (light, "coated") if light == "lit" else (light,):
        try:
            found.append(OutlineFit(picture, kind, sighting, EXPONENTS[kind], begin).outline(backlight_reach))
        except FitError as error:
            failed = error
    if not found:
        raise failed
    return found[0] if len(found) == 1 else _likelier(*found)


def _likelier(one: Outline, other: Outline) -> Outline:
    """Choose the outline with the better model of the light.

    The covariance of the result includes the difference between the outlines, weighted by the likelihood of each model.
    """
    both = one.used & other.used
    chi2, freedom = (
        np.array([np.sum(getattr(each.sectors, name)[both]) for each in (one, other)]) for name in ("chi2", "freedom")
    )
    # the bands differ by a few pixels
    worse = float(np.diff((chi2 - freedom) / max(1.0, float(np.min(chi2 / freedom))))[0]) + _SIMPLER
    best, second = (one, other) if worse >= 0 else (other, one)
    share = 1 / (1 + np.exp(min(abs(worse) / _TEMPER, 50.0)))
    apart = np.array([second.row - best.row, second.column - best.column, second.radius - best.radius])
    return replace(best, covariance=best.covariance + share * (1 - share) * np.outer(apart, apart))


def _searched(picture: MergedPicture, light: LimbLight) -> tuple[float, float, float]:
    """Find row, column and radius, px, of the only sphere in an image."""
    circles = find_circles(
        picture.values, picture.std, bright_inside=light == "lit", mosaic=len(np.unique(picture.channel)) > 1
    )
    if not circles:
        what = "brighter than its background" if light == "lit" else "dark in front of a bright field"
        raise FitError(
            f"{picture.name}: no sphere {what} is visible; show the entire sphere, or specify its centre and radius"
        )
    first = circles[0]
    if len(circles) > 1 and circles[1].score > 0.5 * first.score and circles[1].coverage > 0.35:
        at = " and ".join(
            f"row {c.row + picture.origin[0]:.0f}, column {c.column + picture.origin[1]:.0f}" for c in circles
        )
        raise FitError(f"{picture.name}: there are two spheres, at {at}; crop the frame to one of them")
    _refuse_cut(picture, first)
    return first.row + picture.origin[0], first.column + picture.origin[1], first.radius


def _refuse_cut(picture: MergedPicture, circle: FoundCircle) -> None:
    height, width = picture.values.shape
    left = min(circle.row, height - 1 - circle.row, circle.column, width - 1 - circle.column) - circle.radius
    if left < -0.5:
        raise FitError(
            f"{picture.name}: the frame cuts the sphere: the limb of radius {circle.radius:.0f} px extends {-left:.0f} px "
            "beyond the border; show the entire sphere in the frame"
        )


class OutlineFit:
    """Iterative fit of an outline.

    Each iteration measures the edge of each sector relative to the current curve, and fits a new curve to the edges.

    Args:
        picture: image with the limb.
        light: a key of `EXPONENTS`.
        sighting: geometry of the camera.
        exponents: exponents of the distance inside the limb.
        start: initial row, column and radius, px (3,).
    """

    def __init__(
        self,
        picture: MergedPicture,
        light: str,
        sighting: Sighting,
        exponents: Sequence[float],
        start: np.ndarray,
    ):
        self.picture, self.light, self.sighting = picture, light, sighting
        self.exponents, self.position = tuple(exponents), start
        self.good = np.isfinite(picture.values) & (picture.std > 0) & ~picture.clipped
        self.rows, self.columns = np.indices(picture.values.shape) + np.array(picture.origin)[:, None, None]
        self.inside = float(np.clip(0.1 * start[2], 6, 16))
        self.outside = 5.0
        area = 2 * np.pi * float(start[2]) * (self.inside + self.outside)
        # about 80 pixels in a sector
        self.count = int(np.clip(area / 80, 24, 72))

    def band(self, position: np.ndarray, wider: float = 0.0) -> BandPixels:
        row, column = self.rows - position[0], self.columns - position[1]
        reach = position[2] * 1.02 + self.outside + wider
        near = self.good & (np.abs(row) < reach) & (np.abs(column) < reach)
        row, column = row[near], column[near]
        azimuth = np.arctan2(row, column)
        inside = self.sighting.radius_at(azimuth, *position) - np.hypot(row, column)
        chosen = (inside > -self.outside - wider) & (inside < self.inside + wider)
        values, std, channel = (a[near][chosen] for a in (self.picture.values, self.picture.std, self.picture.channel))
        return BandPixels(inside[chosen], azimuth[chosen], values, std, channel, float(position[2]))

    def edges(self, position: np.ndarray, sigma: float, exponents: Sequence[float], wider: float = 0.0) -> LimbSectors:
        coated = float(self.position[2]) if self.light == "coated" else None
        return sector_edges(self.band(position, wider), blurred_powers(sigma, tuple(exponents), coated), self.count)

    def usable(self, edges: LimbSectors) -> np.ndarray:
        with np.errstate(invalid="ignore"):
            # largest standard deviation of the edge of a sector, px
            sharp = (edges.contrast > _CONTRAST) & (edges.std < 0.3)
            # sectors with 6 times the typical chi squared show dust or a stand
            return sharp & (edges.misfit < 6.0 * np.median(edges.misfit[sharp])) if sharp.any() else sharp

    def slopes(self, position: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
        """Compute the derivatives of the limb's position with respect to row, column and radius, (n, 3).

        The limb's position is measured outwards, along each of n azimuths.
        """
        matrix = np.stack([np.sin(azimuth), np.cos(azimuth), np.ones_like(azimuth)], axis=1)
        if self.sighting.axis is not None:
            at = self.sighting.radius_at(azimuth, *position)
            for k in range(3):
                moved = position + np.eye(3)[k]
                matrix[:, k] = (matrix[:, k] if k < 2 else 0) + self.sighting.radius_at(azimuth, *moved) - at
        return matrix

    def settle(
        self, position: np.ndarray, sigma: float, exponents: Sequence[float], turns: int = 6, wider: float = 0.0
    ) -> tuple[np.ndarray, LimbSectors, np.ndarray, np.ndarray, float]:
        """Iterate the fit to convergence.

        Returns:
            Row, column and radius, px (3,); edges; mask of the used edges; covariance, px^2 (3, 3); rms distance of the used
            edges from the curve, px.
        """
        for _ in range(turns):
            edges = self.edges(position, sigma, exponents, wider)
            step, used, covariance, scatter = self.solve(position, edges, wider)
            position = position + step
            if np.abs(step).max() < 2e-3:
                break
        return position, edges, used, covariance, scatter

    def solve(
        self, position: np.ndarray, edges: LimbSectors, wider: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        """Compute one least-squares step from the curve to the edges.

        A FitError is raised if the edges are too few, or do not determine the curve.

        Returns:
            Step of row, column and radius, px (3,); mask of the used edges; covariance, px^2 (3, 3); rms distance of the used
            edges from the curve, px.
        """
        with np.errstate(invalid="ignore"):
            used = self.usable(edges) & (np.abs(edges.offset) < 2.0 + wider)
        if used.sum() < FEWEST_SECTORS:
            raise FitError(
                f"{self.picture.name}: only {used.sum()} of {self.count} sectors of the limb have a usable edge, but at least "
                f"{FEWEST_SECTORS} are required; light the limb, or photograph the outline in front of a bright field"
            )
        matrix = self.slopes(position, edges.azimuth)
        std = np.nan_to_num(edges.std * np.sqrt(np.maximum(edges.misfit, 1.0)), nan=1.0)
        extra = 0.0
        for _ in range(12):
            weight = 1 / np.hypot(std, extra)[used]
            a = matrix[used] * weight[:, None]
            step, *_ = np.linalg.lstsq(a, edges.offset[used] * weight, rcond=None)
            left = np.nan_to_num(edges.offset - matrix @ step, nan=np.inf)
            freedom = used.sum() - 3
            # additional scatter that makes chi squared equal to its degrees of freedom; robust, from the median
            middle = robust_std(left[used])
            extra = float(np.sqrt(max(middle**2 - np.median(std[used]) ** 2, 0.0)))
            # number of standard deviations from the outline above which an edge is omitted
            keep = used & (np.abs(left) < 4.0 * np.hypot(std, max(extra, 0.01)))
            if keep.sum() == used.sum() or keep.sum() < FEWEST_SECTORS:
                break
            used = keep
        chi2 = float(((left[used] / np.hypot(std, extra)[used]) ** 2).sum())
        covariance = np.linalg.pinv(a.T @ a) * max(1.0, chi2 / freedom)
        if np.sqrt(np.diag(covariance)).max() > 1.0:
            raise FitError(
                f"{self.picture.name}: the visible part of the limb is too short to determine centre and radius of the "
                "sphere; use images of more lamps, or an image with light from behind"
            )
        return step, used, covariance, float(np.sqrt(np.mean(left[used] ** 2)))

    def outline(self, backlight_reach: tuple[float, float] | None = None) -> Outline:
        remarks = []
        # the model of a step and a line converges from any result of the search
        position, *_ = self.settle(self.position, 1.0, (0, 1), turns=4, wider=2.0)
        sigma, _ = self.lens(position)
        position, *_ = self.settle(position, sigma, self.exponents, turns=3)
        sigma, sigma_std = self.lens(position, about=sigma)
        position, edges, used, covariance, scatter = self.settle(position, sigma, self.exponents)
        noise = covariance
        # derivative of the outline with respect to the blur of the lens
        step = 0.1 * sigma + 0.02
        wider = self.settle(position, sigma + step, self.exponents, turns=1)[0]
        by_lens = (wider - position) / step * sigma_std
        covariance = covariance + np.outer(by_lens, by_lens)
        if self.light != "backlit" and len(self.exponents) > 2:
            # change of the outline with the model of the light inside the limb
            by_light = (self.settle(position, sigma, self.exponents[:-1], turns=1)[0] - position) / 2
            covariance = covariance + np.outer(by_light, by_light)
        if self.light == "backlit":
            shrunk, shrunk_std = grazing_reflection(position[2], backlight_reach)
            position = position + np.array([0.0, 0.0, shrunk])
            covariance = covariance + np.diag([0, 0, shrunk_std**2])
            if backlight_reach is None:
                remarks.append(
                    Remark(
                        "backlight-reach-not-given",
                        f"the mirror image of the bright field may reduce the radius by {shrunk_std:.2f} px: specify the "
                        "extent of the field (backlight_reach)",
                    )
                )
        seen = int(np.sum(edges.contrast > _CONTRAST))
        lost = seen - int(used.sum())
        # largest rms distance of the edges of a limb from the outline, px
        if lost > 0.5 * seen or scatter > 0.4:
            raise FitError(
                f"{self.picture.name}: {seen} edges are visible near the limb, and {seen - lost} of them follow one outline "
                f"with an rms distance of {scatter:.2f} px: the background, or its mirror image in the sphere, probably hides "
                "the limb; use a plain background"
            )
        if lost > 0.1 * self.count:
            remarks.append(
                Remark(
                    "limb-spoilt", f"{lost} of {self.count} sectors of the limb were omitted: remove dust or a stand"
                )
            )
        row, column = position[:2] - np.array(self.picture.origin)
        _refuse_cut(self.picture, FoundCircle(row, column, float(position[2]), 1.0))
        return Outline(
            row=float(position[0]),
            column=float(position[1]),
            radius=float(position[2]),
            covariance=covariance,
            sigma=sigma,
            sigma_std=sigma_std,
            sighting=self.sighting,
            sectors=edges,
            used=used,
            scatter=scatter,
            noise=noise,
            coated=self.light == "coated",
            remarks=tuple(remarks),
        )

    def lens(self, position: np.ndarray, about: float | None = None) -> tuple[float, float]:
        """Estimate the standard deviation of the lens's blur from the edges, and the error of this estimate, px."""

        def misfit(log_sigma: float) -> float:
            edges = self.edges(position, float(np.exp(log_sigma)), self.exponents)
            with np.errstate(invalid="ignore"):
                lit = self.usable(edges)
            chosen = lit if lit.sum() >= FEWEST_SECTORS else np.isfinite(edges.chi2)
            if not chosen.any():
                return 0.0
            return float(edges.chi2[chosen].sum() / edges.freedom[chosen].sum())

        tried = np.log(_SIGMAS if about is None else [about * one for one in (0.6, 1.0, 1.7)])
        best = int(np.argmin([misfit(one) for one in tried]))
        bounds = (float(tried[max(best - 1, 0)]), float(tried[min(best + 1, len(tried) - 1)]))
        found = minimize_scalar(misfit, bounds=bounds, method="bounded", options={"xatol": 0.02, "maxiter": 7})
        sigma, least = float(np.exp(found.x)), float(found.fun)
        # at one standard deviation, chi squared exceeds its minimum by the minimum per degree of freedom
        freedom = float(self.edges(position, sigma, self.exponents).freedom.sum())
        step = 0.15
        rise = (misfit(found.x + step) + misfit(found.x - step) - 2 * least) / step**2 / 2
        std = np.sqrt(max(least, 1e-12) / max(rise, 1e-12) / max(freedom, 1.0))
        return sigma, float(sigma * min(std, 1.0))
