"""Functions that draw one kind of result on one panel, for `Summarised.plot`."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from matcam.core import checks
from matcam.core.errors import ArgumentError, unknown_name
from matcam.core.grid import merl_grid, sampling_of
from matcam.figures.calibration import draw_calibration, draw_camera_fit, draw_edge_mtf
from matcam.figures.curves import draw_corrected_lobe, draw_fresnel, draw_prediction
from matcam.figures.sensor import draw_transfer
from matcam.figures.style import BLUE, GREY, VERMILION, channel_colour, degrees_axis, draw_with_std, mtf_lines, styled

if TYPE_CHECKING:
    from matcam.camera.camera import Camera
    from matcam.inverse.correction.correction import Correction
    from matcam.inverse.fit.material_fit import MaterialFit
    from matcam.reconstruction.flat.flat_reconstruction import FlatReconstruction
    from matcam.reconstruction.reconstruction import Reconstruction

_SHOWN = np.pi / 4
"""Default theta_d of the drawn lobe, rad. Most tables contain a complete highlight there."""


def draw_camera(axes: Axes, camera: Camera) -> None:
    """Draw the MTFs of a camera and of its lens.

    The MTF of the camera is drawn along the rows and the diagonal. The MTF of the lens is drawn if the lens is
    isotropic.
    """
    from matcam.camera.optics.varying import VaryingOptics

    if isinstance(camera.optics, VaryingOptics):
        raise ArgumentError(
            "the lens of this camera differs between colours or positions: draw a camera with a single lens, such as "
            "Camera(camera.optics.red, camera.pixel) if the lens has colours"
        )
    frequency = np.linspace(0, 1, 201)
    axes.plot(frequency, np.asarray(camera.mtf(frequency)), color=BLUE, label="lens and pixel, along the rows")
    diagonal = np.asarray(camera.mtf(frequency, np.pi / 4))
    axes.plot(frequency, diagonal, color=BLUE, ls="--", lw=1.2, label="lens and pixel, along the diagonal")
    if camera.optics.isotropic:
        axes.plot(frequency, np.asarray(camera.optics.mtf(frequency)), color=GREY, lw=1.2, label="lens")
    mtf_lines(axes)
    axes.set(xlim=(0, 1), xlabel="frequency [cycles/px]", ylabel="MTF [-]")
    axes.legend(loc="upper right")


def draw_fit(axes: Axes, fit: MaterialFit, channel: int | None = None) -> None:
    """Draw the Fresnel term F of every slice of a fit with its standard deviation.

    `channel` is the index of the channel. Default: None, all channels.
    """
    curves = fit.curves
    theta = np.degrees(curves["theta_d"].values)
    names = [str(name) for name in curves["channel"].values]
    for index in _channels(channel, names):
        value, std = (curves[name].values[:, index] for name in ("fresnel", "fresnel_std"))
        colour = channel_colour(names[index], index)
        draw_with_std(axes, theta, value, std, colour, marker="o", ms=3, lw=1.2, label=names[index])
    degrees_axis(axes, r"difference angle $\theta_d$")
    axes.set_ylabel("F, ± 1 std [-]")
    axes.set_ylim(0, None)
    axes.legend(loc="lower left", title=f"{fit.lobe_name} lobe")


def draw_correction(axes: Axes, done: Correction, theta_d: float = _SHOWN, channel: int | None = None) -> None:
    """Draw the recorded and the corrected lobe over theta_h.

    The azimuth phi_d is 90 degrees. `theta_d` is the difference angle of the lobe, rad. Default: pi / 4. `channel` is
    the index of the channel. Default: None, the middle one.
    """
    _draw_lobe(axes, done.table, theta_d, channel, done.recorded)


def draw_corrected_table(axes: Axes, table: xr.Dataset, theta_d: float = _SHOWN, channel: int | None = None) -> None:
    """Draw the recorded and the corrected lobe of a result of `correct`.

    The recorded lobe is computed from the result. The parameters are those of `draw_correction`.
    """
    from matcam.inverse.correction.corrected_table import recorded_table

    _draw_lobe(axes, table, theta_d, channel, recorded_table(table))


def _draw_lobe(axes: Axes, table: xr.Dataset, theta_d: float, channel: int | None, recorded: xr.DataArray) -> None:
    theta_d = float(checks.scalar("theta_d", checks.within("theta_d", theta_d, 0, np.pi / 2, "rad")))
    names = [str(name) for name in table["channel"].values]
    (channel,) = _channels(len(names) // 2 if channel is None else channel, names)
    grid = merl_grid(sampling_of(table["brdf"]))
    at = (*grid.index(theta_d=theta_d, phi_d=np.pi / 2), channel)
    draw_corrected_lobe(axes, table, recorded, at)
    axes.set_title(rf"$\theta_d$ = {np.degrees(grid.theta_d[at[1]]):.1f}°, channel {names[channel]}", loc="left")
    if axes.lines:
        axes.legend(loc="lower left")


def draw_fresnel_term(axes: Axes, result: xr.Dataset, metal: str | None = None, channel: int | None = None) -> None:
    """Draw the raw and the corrected Fresnel term F.

    `metal` is the name of a metal for comparison. Default: None. `channel` is the index of the channel. Default: None,
    the middle one.
    """
    from matcam.inverse.fresnel_tables import tabulated_fresnel

    names = [str(name) for name in result["channel"].values]
    (channel,) = _channels(len(names) // 2 if channel is None else channel, names)
    tables = None if metal is None else tabulated_fresnel(result, metal)
    draw_fresnel(axes, result, tables, channel)
    axes.set_title(f"Fresnel term, channel {names[channel]}", loc="left")
    # measured curves may cover any part of the axes, so the legend is below them if the layout makes room for it
    if axes.figure.get_layout_engine() is None:
        axes.legend(loc="lower left", fontsize=8)
    else:
        axes.legend(loc="upper left", bbox_to_anchor=(0, -0.14), ncols=2, fontsize=8)


def draw_bounds(axes: Axes, data: xr.Dataset) -> None:
    for name, label, colour in (
        ("width_std", "lens exact", BLUE),
        ("width_std_stated", "lens as specified by its profile", GREY),
        ("width_std_free", "lens free", VERMILION),
    ):
        if np.isfinite(data[name].values).any():
            axes.plot(data["roughness"], data[name], marker="o", ms=4, color=colour, label=label)
    unit = "rad" if data.attrs["ndf"] == "gaussian" else "slope"
    label = f"roughness ({data.attrs['ndf']}) [{unit}]"
    axes.set(xscale="log", yscale="log", xlabel=label, ylabel="bound of ln roughness [-]")
    axes.legend()


def draw_reconstruction(axes: Axes, result: Reconstruction) -> None:
    from matcam.figures.reconstruction_page import draw_reflectance

    draw_reflectance(axes, result)


def draw_flat_reconstruction(axes: Axes, result: FlatReconstruction, map: str = "diffuse") -> None:  # noqa: A002
    """Draw one of the maps of a flat sample.

    `map` is "diffuse" or "specular".
    """
    shown = result.maps[checks.choice("map", map, ("diffuse", "specular"))]
    x, y = shown["x"].values, shown["y"].values
    drawn = axes.imshow(
        shown.values, cmap="gray", extent=(x[0] - 0.5, x[-1] + 0.5, y[-1] - 0.5, y[0] + 0.5), interpolation="nearest"
    )
    axes.grid(visible=False)
    axes.figure.colorbar(drawn, ax=axes, label=f"{map} part, relative [-]")
    axes.set(xlabel="x [px]", ylabel="y [px]")


def _channels(channel: int | None, names: list[str]) -> range:
    if channel is None:
        return range(len(names))
    index = checks.whole_number("channel", channel, 0, len(names) - 1)
    assert index is not None
    return range(index, index + 1)


_ARTISTS: dict[str, Callable[..., None]] = {
    "Calibration": draw_calibration,
    "Camera": draw_camera,
    "CameraFit": draw_camera_fit,
    "Correction": draw_correction,
    "EdgeMTF": draw_edge_mtf,
    "FlatReconstruction": draw_flat_reconstruction,
    "MaterialFit": draw_fit,
    "Reconstruction": draw_reconstruction,
    "SensorCharacteristics": draw_transfer,
    "bounds": draw_bounds,
    "corrected table": draw_corrected_table,
    "Fresnel term": draw_fresnel_term,
    "prediction": draw_prediction,
}
"""Drawing function of each kind of result. Its parameters after the first two are the options of `plot`."""


def draw(kind: str, result: Any, ax: Axes | None, options: Mapping[str, Any]) -> Axes:
    """Draw a result on Axes with the drawing function of its kind.

    Args:
        kind: kind of the result.
        result: the result.
        ax: Axes to draw on. None: Axes of a new figure of pyplot, which a notebook and plt.show() display.
        options: options of the drawing function.

    Raises:
        ArgumentError: there is no drawing function for the kind, `ax` is not an Axes, or an option is unknown.
    """
    if kind not in _ARTISTS:
        raise ArgumentError(f"{kind} has no figure of one panel: draw the arrays of the result")
    artist = _ARTISTS[kind]
    known = list(inspect.signature(artist).parameters)[2:]
    for name in options:
        if name not in known:
            raise unknown_name(f"option of plot() of a {kind}", name, known)
    if ax is not None:
        artist(checks.instance("ax", ax, Axes), result, **options)
        return ax
    import matplotlib.pyplot as plt

    with styled():
        figure, ax = plt.subplots(figsize=(7.5, 4.4), layout="constrained")
        try:
            artist(ax, result, **options)
        except Exception:
            plt.close(figure)
            raise
    return ax
