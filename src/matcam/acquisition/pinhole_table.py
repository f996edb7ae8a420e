"""Binning of images of a sphere as if the camera were a pinhole: a table without correction for the lens.

Each pixel represents the normal at its centre. The ratio of its radiance to its irradiance is added to the cell of its
half and difference angles. The value of a cell is the mean of its pixels. Published tables of measured materials were
computed in this way. The difference between this table and a reconstruction shows the effect of the camera. Images are
added one at a time, so memory does not grow with their number.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from matcam.acquisition.merged_picture import MergedPicture
from matcam.acquisition.mirror_ball import MirrorBall, unit
from matcam.core.errors import ArgumentError, FitError
from matcam.core.grid import CHANNELS, GRID_SHAPE, brdf_table, merl_grid
from matcam.core.shading import shading, vector

_CELLS = int(np.prod(GRID_SHAPE))
_LEAST = np.cos(np.radians(87.0))
"""Smallest cosine of the angles of light and view of a pixel that is used, no unit."""


class PinholeTable:
    """Mean of the pixels of images of a sphere in the cells of the MERL grid.

    Args:
        channels: colours of the images: ("R", "G", "B"), or a single colour, which is used for all three.

    Raises:
        ArgumentError: the number of channels is neither 1 nor 3.

    Example:
        >>> values = np.full((40, 40), 0.25)
        >>> picture = MergedPicture("1", values, values / 10, values > 1, np.zeros((40, 40), int), ("grey",))
        >>> table = PinholeTable(("grey",))
        >>> table.add(picture, MirrorBall(20.0, 20.0, 15.0), np.array([0.0, 0.0, 1.0]))
        >>> table.pixels > 500
        True
    """

    def __init__(self, channels: tuple[str, ...] = CHANNELS):
        if len(channels) not in (1, 3):
            raise ArgumentError(f"channels must be one or three colours, got {len(channels)}: {', '.join(channels)}")
        self.channels = tuple(channels)
        self._sum, self._number = (np.zeros((len(channels), _CELLS)) for _ in range(2))
        self.pixels = 0
        self.clipped = 0

    def add(
        self,
        picture: MergedPicture,
        ball: MirrorBall,
        lamp: np.ndarray,
        lamp_distance: float = np.inf,
        irradiance: float | np.ndarray = 1.0,
    ) -> None:
        """Add the pixels of one image. Clipped pixels are counted and omitted.

        Args:
            picture: image of one lamp.
            ball: the sphere in this frame.
            lamp: direction from the sphere's centre (3,): x right, y up, z to the camera.
            lamp_distance: distance of the lamp from the centre, radii. Default: infinite.
            irradiance: irradiance of a surface at the sphere's centre that faces the lamp, as the value of a pixel
                divided by BRDF and cosine; one value, or one for each channel. Default: 1.

        Raises:
            ArgumentError: the colours of the image are not those of the table.
        """
        if picture.channels != self.channels:
            raise ArgumentError(
                f"{picture.name}: the colours of the image are {picture.channels}, but must be {self.channels}, as in the table"
            )
        reach, centre = 1.1 * ball.radius, np.array([ball.row, ball.column]) - picture.origin
        first, last = (np.maximum(end, 0).astype(int) for end in (np.floor(centre - reach), np.ceil(centre + reach)))
        window = tuple(slice(a, b + 1) for a, b in zip(first, last, strict=True))
        values, clipped, channel = (a[window] for a in (picture.values, picture.clipped, picture.channel))
        rows, columns = np.indices(values.shape)
        normals = ball.normals(rows + first[0] + picture.origin[0], columns + first[1] + picture.origin[1])
        lamp = unit(np.asarray(lamp, float))
        nearness = 1 / lamp_distance
        way = lamp - nearness * normals
        far = np.linalg.norm(way, axis=-1)
        light, view = way / far[..., None], ball.views(normals)
        cos_i, cos_o = (light * normals).sum(-1), (view * normals).sum(-1)
        with np.errstate(invalid="ignore"):
            seen = np.isfinite(normals[..., 0]) & (np.minimum(cos_i, cos_o) > _LEAST)
        self.clipped += int(np.count_nonzero(seen & clipped))
        seen &= np.isfinite(values) & ~clipped
        light_of = np.broadcast_to(np.asarray(irradiance, float), len(self.channels))[channel[seen]]
        brdf = values[seen] * far[seen] ** 2 / (cos_i[seen] * light_of)
        cells = self._cells(normals[seen], light[seen], view[seen])
        for k in range(len(self.channels)):
            of = channel[seen] == k
            self._number[k] += np.bincount(cells[of], minlength=_CELLS)
            self._sum[k] += np.bincount(cells[of], brdf[of], minlength=_CELLS)
        self.pixels += int(np.count_nonzero(seen))

    @staticmethod
    def _cells(normals: np.ndarray, light: np.ndarray, view: np.ndarray) -> np.ndarray:
        tangent = unit(np.stack([normals[:, 2], np.zeros(len(normals)), -normals[:, 0]], axis=1))
        at = shading(*(vector(*each.T) for each in (normals, tangent, light, view)))
        theta_h = np.arctan(np.hypot(at.slope_along, at.slope_across))
        i, j, k = merl_grid("centre").index(
            theta_h=theta_h, theta_d=np.minimum(at.theta_d, np.pi / 2), phi_d=np.mod(at.phi_d, np.pi)
        )
        return np.ravel_multi_index((i, j, k), GRID_SHAPE)

    def table(self) -> xr.DataArray:
        """Compute the table, the mean of the pixels in every cell, 1/sr; NaN without pixels.

        Raises:
            FitError: no pixel was used.
        """
        if not self.pixels:
            raise FitError(
                "no pixel of any image is lit, visible and unclipped: add images, and check that each lamp direction points "
                "to the lamp"
            )
        total, number = (a.reshape(-1, *GRID_SHAPE) for a in (self._sum, self._number))
        # phi_d and pi - phi_d are equivalent
        total, number = total + total[..., ::-1], number + number[..., ::-1]
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = np.moveaxis(np.where(number > 0, total / number, np.nan), 0, -1)
        if len(self.channels) == 1:
            mean = np.repeat(mean, 3, axis=-1)
        return brdf_table(mean, "centre", method="pinhole binning", pixels=self.pixels, clipped_left_out=self.clipped)
