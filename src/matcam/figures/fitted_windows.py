"""Data for figures of a reconstruction: the pixels about each highlight, and slices of the pinhole table."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from matcam.reconstruction.picture_rule import WINDOW

if TYPE_CHECKING:
    from matcam.reconstruction.reconstruction import Reconstruction


def fitted_windows(result: Reconstruction) -> xr.Dataset:
    """Collect outline, highlight and window of every image of a sphere.

    Args:
        result: the reconstruction.

    Returns:
        Dataset. These variables depend on `picture`, `window_row` and `window_column`. They are NaN in unused pixels:

        - `window_recorded` and `window_fitted`, in the unit of the merged images.
        - `window_residual`, recorded minus fitted, in standard deviations. It is also NaN in clipped pixels.

        These variables depend on `picture`:

        - `picture_name`, and `picture_theta_d`, the difference angle at the highlight, rad.
        - `window_left` and `window_top`, first column and first row of the window, px.
        - `outline_column`, `outline_row` and `outline_radius`, centre and radius of the fitted outline, px.
        - `highlight_column` and `highlight_row`, position of the brightest pixel of the fitted window, px.
    """
    solution, layout = result.fit.solution, result.fit.layout
    problem, p = solution.problem, solution.p
    count = WINDOW * WINDOW
    rows = []
    for k in range(layout.pictures):
        pixels = problem.pixels[k]
        window = pixels.window
        model = problem.picture(p, k, slopes=False).value[:count]
        used, values = pixels.used[:count], pixels.values[:count]
        std = np.hypot(pixels.std[:count], solution.unexplained * np.abs(model))
        left = np.where(used & ~pixels.clipped[:count], (values - model) / std, np.nan)

        def picture(flat: np.ndarray, turned: float = window.turned) -> np.ndarray:
            square = flat.reshape(
                WINDOW, WINDOW
            )  # v before u; u runs along the axis of the rows if the window is turned
            return square.T if turned else square

        column, row = (window.pixel_v, window.pixel_u) if window.turned else (window.pixel_u, window.pixel_v)
        fitted = picture(np.where(used, model, np.nan))
        at = np.unravel_index(int(np.argmax(np.where(np.isfinite(fitted), fitted, -1.0))), fitted.shape)
        centre = p[layout.own(k)][:2]
        rows.append(
            {
                "window_recorded": picture(np.where(used, values, np.nan)), "window_fitted": fitted,
                "window_residual": picture(left), "window_left": column[0], "window_top": row[0],
                "outline_column": centre[0], "outline_row": centre[1], "outline_radius": p[layout.scene][1],
                "highlight_column": column[at[1]], "highlight_row": row[at[0]], "picture_theta_d": solution.theta_d[k],
            }
        )  # fmt: skip
    columns = {name: np.array([one[name] for one in rows]) for name in rows[0]}
    dims = ("picture", "window_row", "window_column")
    data = xr.Dataset(
        {
            name: (dims[: values.ndim], values.astype(np.float32) if values.ndim == 3 else values)
            for name, values in columns.items()
        }
    )
    for name in data:
        unit = "rad" if name == "picture_theta_d" else "px" if data[name].ndim == 1 else ""
        if unit:
            data[name].attrs["units"] = unit
    data["window_residual"].attrs["units"] = "standard deviations"
    data["picture_name"] = ("picture", np.array(result.fit.names, dtype=object))
    return data


def pinhole_slice(pinhole: xr.DataArray, theta_d: int, channel: int) -> np.ndarray:
    """Compute the mean over phi_d of a slice of the pinhole table, 1/sr.

    The mean is used because few cells of one azimuth contain a pixel.

    Args:
        pinhole: the pinhole table.
        theta_d: index of the slice.
        channel: index of the channel.

    Returns:
        Mean over theta_h; NaN where there are no pixels, or where the mean is not positive.
    """
    all_round = np.asarray(pinhole.values[:, theta_d, :, channel], dtype=float)
    there = np.isfinite(all_round)
    mean = np.where(there, all_round, 0.0).sum(axis=1) / np.where(there.any(axis=1), there.sum(axis=1), np.nan)
    return np.where(mean > 0, mean, np.nan)
