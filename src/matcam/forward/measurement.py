"""Table of a material as recorded by a rig: the pixels of every cell of the MERL grid (docs/model.md 3).

One image of a sphere, with an angle of 2 theta_d between lamp and camera, contains one theta_d slice of a table. Each
cell occurs twice in this image: at the azimuth pi - phi_d about the half vector, and at the opposite azimuth. Each record
is divided by the cosine of the angle of incidence at its position. The value of a cell is the mean of the two quotients.
Positions and quadrature nodes depend only on the rig, so a workspace stores the plan for further materials. Cells on the
same pixel have the same noise (docs/model.md 8).
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from jax.typing import ArrayLike

from matcam.camera.optics.colour import ColourOptics
from matcam.camera.sensor import PixelNoise
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.grid import (
    CHANNEL_WAVELENGTHS,
    CHANNELS,
    GRID_SHAPE,
    Sampling,
    azimuth_of,
    brdf_table,
    checked_table,
    merl_grid,
    sampling_of,
)
from matcam.core.jax import AnyArray, computes_on_gpu, is_concrete, jax, jnp, transferred
from matcam.core.workspace import Workspace, default_workspace
from matcam.forward.cells_in_pictures import (
    CellChoice,
    RealCells,
    TableCells,
    cell_means,
    cell_sampling,
)
from matcam.forward.cylinder_cells import check_cylinder, record_cells
from matcam.forward.frequencies.table_records import frequency_error, record_by_frequencies, served_by_frequencies
from matcam.forward.integral.blur import Imaging, imaging_of, kernel_error
from matcam.forward.pixel_grid import phase_of_slices, pixel_numbers, slice_pixels
from matcam.forward.sampler.plan import graded_for
from matcam.forward.sampler.planned_blocks import PlannedBlocks
from matcam.forward.sampler.under_lamp import record_under_lamp
from matcam.lamp.lamps import disc_of
from matcam.material.material import Material, cell_values, check_material
from matcam.material.microfacet import Microfacet
from matcam.material.ndf.gaussian_lobe import GaussianNDF
from matcam.material.optical_constants import metal
from matcam.material.reflectance import Conductor
from matcam.rigs import UNKNOWN, Rig, merl
from matcam.sample.curved import Cylinder, Sphere
from matcam.sample.positions import positions_of
from matcam.sample.shape import Flat


def measure(
    material: Material, rig: Rig, workspace: Workspace | None = None, *, azimuth: ArrayLike | None = None
) -> xr.DataArray:
    """Simulate the BRDF table that a rig records of a material.

    The value of a cell comes from a pixel centred on the point of the cell that `cell_value` of the rig specifies.
    "mean" is the mean over the pixels inside the cell. For "nearest" and "bilinear", and for "mean" if the rig has a
    `pixel_phase`, the value comes from the pixels of a real grid. Several cells near the peak then have the value of
    the same pixel. The record is divided by the cosine of the angle of incidence at the centre of the pixel. The value is
    the mean over the two positions of the cell, which are reciprocal configurations. The radiance of a flat sample is
    uniform, so blur does not change the record of a flat sample.

    In a near rig, each cell is recorded in the image in which its angles occur, and the record is divided by the
    irradiance at its position. The computing time is proportional to the number of points of the lamp; a source disc has
    at least 16 points. For derivatives see `table_values`.

    On a cylinder, cells are recorded on the line at height 0 that is perpendicular to the axis of the cylinder. Each
    cell has a separate image, whose lamp is rotated about the optical axis until the normal of the cell occurs on that
    line.

    Args:
        material: material to record, such as `Microfacet(GGX(0.1), 0.9)`, with one channel (grey) or three.
        rig: camera, sample and lamp; any sample.
        workspace: store of the plan of a table, for further materials. Default: None, the workspace of the process.
        azimuth: azimuth of the lamp about the optical axis in all images, in [-2 pi, 2 pi], rad. The plane of
            incidence rotates with the lamp; the square pixels do not. Default: None, the rig's `lamp_azimuth`, or 0,
            the lamp towards +x.

    Returns:
        BRDF, 1/sr, on the MERL grid (theta_h, theta_d, phi_d, channel), NaN for invisible cells. Coordinate `pixels`
        (theta_h, theta_d, phi_d) is the number of pixels of a cell at both of its positions. Attribute `kernel_error` is
        the largest error of the transfer function of the lens; 0 for Gaussian lenses.

    Raises:
        ArgumentError: the material has neither one nor three channels; the lens varies over the field, and the camera
            or the lamp is near or the lamp has a disc; the `cell_value` of the rig is "mean", "nearest" or "bilinear"
            for a flat sample or a cylinder; a lamp azimuth or a lens that is not isotropic is specified for a cylinder;
            or the call is inside jax.jit.

    Source:
        docs/model.md 2 and 3. The error is below 1e-4 of the value or 1e-7 of the peak for Gaussian optics (tests).

    Example:
        A perfect measurement of a flat sample. For a sphere use `matcam.measure(material, matcam.rigs.merl())`.

        >>> material = matcam.Microfacet(matcam.GGX(0.1), 0.9)
        >>> table = matcam.measure(material, matcam.Rig(matcam.rigs.merl().camera, matcam.Flat()))
        >>> table.dims, table.shape
        (('theta_h', 'theta_d', 'phi_d', 'channel'), (90, 90, 180, 3))
        >>> print(np.round(table.values[0, 0, 0], 2))
        [7.16 7.16 7.16]
    """
    recorded, pixels = table_values(material, rig, workspace, azimuth=azimuth)
    if recorded.shape[-1] not in (1, len(CHANNELS)):
        raise ArgumentError(f"a table needs a material with 1 or {len(CHANNELS)} channels, got {recorded.shape[-1]}")
    # far below the peak, the error of the interpolation between positions may exceed a value
    values = np.broadcast_to(np.maximum(np.asarray(recorded), 0.0), (*GRID_SHAPE, len(CHANNELS))).copy()
    lenses = [one for one, _ in _colours(rig)]
    by_frequencies = [served_by_frequencies(one, material) for one in lenses]
    written = "centre" if rig.cell_value == UNKNOWN else rig.cell_value
    attrs = {
        "cell_value": written,
        "sample": rig.sample.kind,
        "rig": repr(rig),
        "kernel_error": max(
            (frequency_error if by else kernel_error)(one) for one, by in zip(lenses, by_frequencies, strict=True)
        ),
        "route": "frequencies" if all(by_frequencies) else "space",
    }
    attrs["lamp_azimuth"] = _azimuth(rig, azimuth)
    if rig.pixel_phase is not None:
        attrs["pixel_phase"] = np.ravel(rig.pixel_phase).tolist()
    table = brdf_table(values, cell_sampling(rig.cell_value), **attrs)
    about = {"units": "1", "long_name": "number of pixels of the cell"}
    return table.assign_coords(pixels=(("theta_h", "theta_d", "phi_d"), pixels, about))


def table_values(
    material: Material, rig: Rig, workspace: Workspace | None = None, *, azimuth: ArrayLike | None = None
) -> tuple[jax.Array, np.ndarray]:
    """Compute the values and pixel counts of `measure` as arrays.

    The values are differentiable in the parameters of material and camera.

    Args:
        material: material to record, with any number of channels.
        rig: camera, sample and lamp; any sample.
        workspace: store of the plan of a table, for further materials. Default: None, the workspace of the process.
        azimuth: azimuth of the lamp about the optical axis in all images, rad. Default: None, the rig's `lamp_azimuth`,
            or 0, the lamp towards +x.

    Returns:
        BRDF, (90, 90, 180, channels), 1/sr, NaN for invisible cells; and the number of pixels of each cell,
        (90, 90, 180).

    Raises:
        ArgumentError: see `measure`.

    Source:
        docs/model.md 2 and 3.

    Example:
        >>> flat = matcam.Rig(matcam.rigs.merl().camera, matcam.Flat())
        >>> values, pixels = matcam.forward.table_values(matcam.Microfacet(matcam.GGX(0.1), 0.9), flat)
        >>> values.shape, pixels.shape
        ((90, 90, 180, 1), (90, 90, 180))
    """
    check_material(material)
    material = transferred(material)  # here, so that compiled programs do not transfer it at each call
    checks.instance("rig", rig, Rig, "rigs.merl()")
    workspace = checks.instance("workspace", default_workspace() if workspace is None else workspace, Workspace)
    if isinstance(rig.sample, Flat):
        return _flat_values(material, rig), np.zeros(GRID_SHAPE)
    if isinstance(rig.sample, Cylinder):
        check_cylinder(rig, _azimuth(rig, azimuth))
        return _on_cylinder(material, rig, rig.sample, workspace)
    seen = [_values_through(material, one, _azimuth(rig, azimuth), shift, workspace) for one, shift in _colours(rig)]
    if len(seen) == 1:
        return jnp.asarray(seen[0][0]), seen[0][1]
    channels = [values[..., min(c, values.shape[-1] - 1)] for c, (values, _) in enumerate(seen)]
    return jnp.stack(channels, axis=-1), seen[0][1]


def _colours(rig: Rig) -> list[tuple[Rig, tuple[float, float]]]:
    """List the rig and the image shift, (right, up), px, of each colour; one rig without shift if the lens is achromatic."""
    optics = rig.camera.optics
    if not isinstance(optics, ColourOptics):
        return [(rig, (0.0, 0.0))]
    shifts = ((float(right), float(up)) for right, up in optics.shifts)
    return list(zip(rig.colours, shifts, strict=True))


def _values_through(
    material: Material, rig: Rig, azimuth: float, shift: tuple[float, float], workspace: Workspace
) -> tuple[AnyArray, np.ndarray]:
    """Compute values and pixel counts of a table through one lens. shift: shift of the images, (right, up), px."""
    if served_by_frequencies(rig, material):
        return _by_frequencies(material, rig, azimuth, shift)
    imaging = imaging_of(rig)
    even = imaging.blur.even and shift[1] == 0
    stds = jax.lax.stop_gradient(imaging.blur.stds)
    finest = float(np.min(np.asarray(stds))) if is_concrete(stds) else None
    chosen = CellChoice(rig.cell_value, rig.crop, azimuth, rig.pixel_phase, even, shift, finest)
    if disc_of(rig.lamp) > 0:
        cells = chosen.cells(imaging.sample, imaging.lamp_nearness)
        return cell_means(record_under_lamp(material, rig, imaging, cells.positions), cells), cells.pixels
    lobe = graded_for(checks.outside_jit(material.finest, "the material's parameters"), imaging), material.elongation
    cells, plan = _table_plan(imaging, chosen, lobe, workspace)
    return cell_means(plan.record(material, imaging), cells), cells.pixels


def _on_cylinder(material: Material, rig: Rig, sample: Cylinder, workspace: Workspace) -> tuple[jax.Array, np.ndarray]:
    """Compute values and pixel counts of a table of a cylinder."""
    sample, near = jax.lax.stop_gradient((sample, rig.lamp.nearness))
    chosen = CellChoice(rig.cell_value, rig.crop)
    key = float(sample.radius), float(sample.distance), 0.0 if near is None else float(near), chosen
    cells = workspace.remember("cylinder cells", key, lambda: chosen.cells(sample, near), most=1)
    return jnp.asarray(cell_means(record_cells(material, rig, cells.positions), cells)), cells.pixels


def _by_frequencies(
    material: Material, rig: Rig, azimuth: float, shift: tuple[float, float]
) -> tuple[AnyArray, np.ndarray]:
    """Compute values and pixel counts of a table by filtering the image of each slice. shift: see `_values_through`."""
    even = rig.camera.optics.isotropic and shift[1] == 0
    chosen = CellChoice(rig.cell_value, rig.crop, azimuth, rig.pixel_phase, even, shift)
    assert isinstance(rig.sample, Sphere)
    cells = chosen.cells(rig.sample)
    angles = 2 * merl_grid(cell_sampling(chosen.cell_value)).theta_d
    return cell_means(record_by_frequencies(material, rig, angles, azimuth, cells.positions), cells), cells.pixels


def _azimuth(rig: Rig, azimuth: ArrayLike | None) -> float:
    """Choose the azimuth of the lamp, rad: the given azimuth, else the azimuth of the rig, else 0."""
    return float(checks.scalar("azimuth", rig.azimuths(azimuth)))


def true_table(material: Material, sampling: Sampling = "centre") -> xr.DataArray:
    """Evaluate the table of a material without a camera.

    Args:
        material: the material.
        sampling: point of each cell at which the BRDF is evaluated, "centre" or "edge". Default: "centre".

    Returns:
        BRDF on the MERL grid, (90, 90, 180, 3), 1/sr; NaN below the horizon.

    Raises:
        ArgumentError: the sampling is neither "centre" nor "edge".

    Example:
        >>> table = matcam.forward.true_table(matcam.Microfacet(matcam.GGX(0.1), 0.9))
        >>> table.sizes["theta_h"]
        90
    """
    return measure(material, Rig(merl().camera, Flat(), cell_value=sampling))


def _table_plan(
    imaging: Imaging, chosen: CellChoice, lobe: tuple[float, float], workspace: Workspace
) -> tuple[TableCells | RealCells, PlannedBlocks]:
    """Compute the cells of a table and the plan of their record.

    An ArgumentError is raised if parameters of the rig are traced by jax.jit.

    lobe: narrowest scale, rad, and elongation of the lobe, see `record_plan`.
    """
    imaging = jax.lax.stop_gradient(imaging)
    leaves, tree = jax.tree.flatten(imaging)
    if not all(is_concrete(leaf) for leaf in leaves):
        raise ArgumentError(
            "the rig must have concrete parameters, because they determine the pixels of a table: call this function "
            "outside jax.jit and jax.vmap"
        )

    def plan() -> tuple[TableCells | RealCells, PlannedBlocks]:
        cells = chosen.cells(imaging.sample, imaging.lamp_nearness)
        plan = PlannedBlocks(imaging, cells.positions, *lobe)
        if computes_on_gpu():
            cells = transferred(cells)._replace(pixels=cells.pixels)
        return cells, plan

    key = tree, tuple(np.asarray(leaf).tobytes() for leaf in leaves), chosen, lobe
    return workspace.remember("table plan", key, plan, most=1)


def _flat_values(material: Material, rig: Rig) -> jax.Array:
    """Compute the table of a flat sample, the mean of both reciprocal configurations, 1/sr, (90, 90, 180, channels).

    The sample is assumed to be tilted so that each cell is visible. Blur does not change its uniform radiance.
    """
    if rig.cell_value not in ("centre", "edge", UNKNOWN):
        raise ArgumentError(
            "cell_value must be 'centre' or 'edge' for a flat sample, because all its pixels belong to one cell, got "
            f"'{rig.cell_value}'"
        )
    return jnp.asarray(cell_values(material, cell_sampling(rig.cell_value)))


CHROMIUM_WIDTH = 0.002
"""Width of the lobe of `simulated_chromium`, rad: half a pixel on the MERL rig's sphere."""


def with_pixel_noise(table: xr.DataArray, rig: Rig, noise: PixelNoise, seed: int) -> xr.DataArray:
    """Add pixel noise to a table.

    Each theta_d slice is one image. Cells on the same pixel have the same noise, and the noise of a mean of pixels is the
    mean of their noise. Negative results are kept, because clipping would bias faint cells.

    Args:
        table: BRDF on the MERL grid, (90, 90, 180, channels), 1/sr.
        rig: rig that recorded the table; its sample must be a `Sphere`, or a `Cylinder` with separate pixels for each
            cell.
        noise: standard deviations relative to the value of the pixel and to the brightest pixel of its image, no unit.
            `picture_gain` is not used.
        seed: seed of the random numbers, an integer; the same seed gives the same noise.

    Returns:
        Table with noise, with the coordinates and attributes of `table`.

    Raises:
        ArgumentError: the sample is flat, the noise is out of its range, the seed is not a non-negative integer, or the
            table is not on the MERL grid. For a cylinder also: the lamp has an azimuth, or the `cell_value` of the rig is
            "mean", "nearest" or "bilinear".

    Source:
        docs/model.md 8: noise belongs to pixels, not to cells.

    Example:
        >>> material = matcam.Microfacet(matcam.GGX(0.1), 0.9)
        >>> table = matcam.measure(material, matcam.Rig(matcam.rigs.merl().camera, matcam.Flat()))
        >>> noisy = matcam.forward.with_pixel_noise(table, matcam.rigs.merl(), matcam.camera.PixelNoise(0.01, 0.0), seed=1)
        >>> bool(abs(noisy / table - 1).mean() < 0.01)
        True
    """
    checks.instance("noise", noise, PixelNoise).check()
    checks.instance("rig", rig, Rig)
    if not isinstance(rig.sample, Sphere | Cylinder):
        raise ArgumentError(f"a noisy table needs a rig with a Sphere or Cylinder, not a {type(rig.sample).__name__}")
    rng = np.random.default_rng(checks.whole_number("seed", seed, 0))
    sampling = sampling_of(checked_table(table))
    phase = rig.pixel_phase
    on_line = isinstance(rig.sample, Cylinder)
    if phase is None and rig.cell_value == "mean" and rig.sample.distant:
        phase = 0.0, 0.0  # an arbitrary phase, because the phase is unknown
    phases = None if phase is None else phase_of_slices(phase)
    azimuth = _azimuth(rig, azimuth_of(table))
    if isinstance(rig.sample, Cylinder):
        check_cylinder(rig, azimuth)
    pixels = None if phases is not None or on_line else cell_pixels(rig.sample, sampling, azimuth)  # type: ignore[arg-type]
    values = table.values.copy()
    for j in range(GRID_SHAPE[1]):
        if phases is not None:
            theta_d, radius = merl_grid(sampling).theta_d[j], float(rig.sample.radius)
            share = slice_pixels(rig.cell_value, phases[j], radius, theta_d, rig.crop, azimuth).share
            of_pixels = rng.standard_normal((2, share.shape[1], values.shape[3]))
            draws = np.stack([share @ e for e in of_pixels]).reshape(2, *values[:, j].shape)
        elif pixels is not None:
            numbers, position = np.unique(pixels[:, j], return_inverse=True)
            position = position.reshape(pixels[:, j].shape)
            draws = rng.standard_normal((2, numbers.size, values.shape[3]))[:, position].mean(axis=1)
        else:  # each direction has its own pixel
            draws = rng.standard_normal((2, 2, *values[:, j].shape)).mean(axis=1)
        picture = values[:, j]
        brightest = np.nanmax(picture, axis=(0, 1), initial=0.0)
        values[:, j] = picture * (1 + noise.relative * draws[0]) + noise.floor * brightest * draws[1]
    return table.copy(data=values)


def cell_pixels(sphere: Sphere, sampling: Sampling, azimuth: float = 0.0) -> np.ndarray:
    """Number the pixels of all cells in the images of a sphere, see `pixel_numbers`, (2, theta_d, theta_h, phi_d).

    The first axis is that of the azimuth pi - phi_d about the half vector and of the opposite azimuth. The optical axis is at
    the centre of a pixel.

    azimuth: azimuth of the lamp, rad.
    """
    grid = merl_grid(sampling)
    theta_h, theta_d, phi_d = grid.theta_h[:, None], grid.theta_d[:, None, None], grid.phi_d
    positions = (positions_of(sphere, theta_h, theta_d, phi_d + turn) for turn in (0, np.pi))
    return np.stack([pixel_numbers(x, y, azimuth=azimuth) for x, y, _ in positions])


def simulated_chromium() -> xr.DataArray:
    """Simulate the table of an ideal chromium sphere on the MERL rig.

    The lobe is Gaussian, 0.002 rad wide. The refractive index n + i k is from Rakic et al. (1998). The noise is 1 % of the
    value of a pixel, without a floor, because a MERL file cannot contain negative values. The true BRDF is known, so the
    table is useful for demonstrations and for tests of the installation. The tests of the method are in tests/oracle.
    """
    return default_workspace().remember("simulated chromium", (), _noisy_chromium, most=1).copy()


def _noisy_chromium() -> xr.DataArray:
    n, k, _ = metal("Cr", CHANNEL_WAVELENGTHS, "rakic")
    # without masking, which is 1 to within 1e-6 up to 89 degrees for such a smooth surface
    chromium = Microfacet(GaussianNDF(CHROMIUM_WIDTH), Conductor(n, k), masking=None)
    table = with_pixel_noise(measure(chromium, merl()), merl(), PixelNoise(0.01, 0.0), seed=1)
    return table.assign_attrs(source="simulated chromium")
