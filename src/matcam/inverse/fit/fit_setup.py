"""Setup of a fit: data, rig, model, prior and noise (docs/model.md 8).

`FitSetup` combines cells, operator, data, problem and search. `setup.with_(...).solve(start=found)` continues from
another fit, for example in more slices, with a free parameter of the rig, or with a spline-modified lobe.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
import xarray as xr
from scipy.linalg import block_diag

from matcam.camera.parameters import Uncertainty
from matcam.camera.sensor import PixelNoise
from matcam.core import checks
from matcam.core.errors import ArgumentError, FitError
from matcam.core.grid import checked_table, sampling_of
from matcam.core.registry import FAMILIES, FRESNEL_MODELS
from matcam.core.workspace import Workspace, default_workspace
from matcam.forward.pixel_grid import PixelGrid
from matcam.inverse.fit.fit_data import SEARCH_STEP, check_values, fit_data
from matcam.inverse.fit.fit_parameters import STUDENT, TWO_LOBES, FresnelModel, Layout, LobeKind
from matcam.inverse.fit.fit_problem import FitProblem, Prior
from matcam.inverse.fit.material_fit import MaterialFit, material_fit
from matcam.inverse.fit.search import Search, Solution
from matcam.inverse.operator.chosen_cells import ChosenCells
from matcam.inverse.operator.lobe_operator import (
    LobeOperator,
    WholeRule,
    check_rig,
    lobe_operator,
    perfect_operator,
)
from matcam.inverse.operator.pixel_phase import located_rig
from matcam.inverse.operator.sample_view import FAR_AWAY, SampleView, rig_behind, sample_view
from matcam.inverse.rig.lens_changes import ASSUMED, CHANGES, WIDTH
from matcam.inverse.rig.rig_axes import (
    LENS,
    Axis,
    axis_selection,
    change_axis,
    free_axis,
    is_lens_width,
    known_lens,
    prior_axis,
    shape_axes,
)
from matcam.inverse.saturated_values import without_saturated
from matcam.material.masking import MASKINGS, Masking
from matcam.material.ndf.free_lobe import KNOTS, SHADOWS
from matcam.rigs import Rig

CameraParameters = Literal["fixed", "prior", "free"]
CAMERA_PARAMETERS: tuple[CameraParameters, ...] = ("fixed", "prior", "free")

AUTO = "auto"
"""Default family of the lobe: the most probable of the candidates."""
CANDIDATES = ("ggx", "epd")
LOOK_STEP = 3 * SEARCH_STEP
"""Spacing of the slices of theta_d in which starting points of a search and explanations are compared."""
_LOOK_ROUNDS = 2
"""Largest number of updates of the weights in the slices with spacing `LOOK_STEP`; later updates use all slices."""


@dataclass(frozen=True)
class FitSetup:
    """Complete specification of a fit.

    Attributes:
        tables: tables that one rig recorded, 1/sr; one table per material.
        rig: rig that recorded the tables; None: a perfect camera.
        ndf: family of the lobe, as in `fit`, or "student-t" or "two-lobes". Default: "ggx".
        fresnel: model of the Fresnel term F, as in `fit`. Default: "conductor".
        diffuse: True to add a diffuse part. Default: False.
        coated: True to fit the share of the diffuse part that is under a coat. Default: False, a Lambertian part.
        base: True to add a rough base under the lobe (`body.py`). Default: False.
        per_channel: True for one lobe per channel. Default: False, one lobe per table.
        masking: model of the masking G of the lobe, as in `fit`. Default: "smith".
        camera_parameters: treatment of the parameters of the rig: "fixed", "prior" or "free". Default: None, "fixed" without
            a rig or for an exact camera, otherwise "prior". The lens width of a camera without uncertainty is assumed to be
            known to 10 %.
        free: names of the parameters of the rig that are fitted if `camera_parameters` is "free". Default: the width of a
            Gaussian lens.
        also: names of further parameters of the rig that are fitted without a prior. Default: ().
        nearby: True to restrict the radius of the lamp in `also` to a range about its specified value. Default: False.
        refitted: names of the parameters that later fits specify in `also`, with `nearby` True. The quadrature rules of these
            fits are computed together with those of this fit. Default: ().
        lens_shape: True to fit the shape of the kernel of the lens (`rig_axes.shape_axes`). Default: False.
        spline: prior standard deviation of the second differences of the spline that modifies the logarithm of the lobe
            (no unit). Default: 0, no modification.
        stiff_below: slope (no unit) below which the spline is ten times stiffer. With a rig, the smallest value is the slope
            across one pixel at the middle of the sample. Default: 0.
        learned_spline: value of `spline` estimated from the data, for slopes at which the spline is not stiff. Default:
            None, the value of `spline`.
        free_masking: True to fit G as any smooth function of the angle. Default: False.
        noise: noise of a pixel and of the image gain. Default: None, estimated from the residuals.
        slice_step: spacing of the slices of theta_d (no unit), from 1 to 30. Default: 1, all slices.
        view: sphere that defines the pixels if `rig` is None. Default: a radius of 256 px, distant camera and lamp.
        pixels: pixel grid from which cells are read if `rig` is None. Default: None, each cell has its own pixels.
        workspace: store of results that depend only on the rig. Default: None, the store of the process.

    Raises:
        ArgumentError: a field is out of its range, a fit does not support the rig, or the tables differ in sampling or rig.
        FitError: the cells of the first table contradict the rig.

    Example:
        >>> setup = matcam.inverse.FitSetup((table,), matcam.rigs.merl(), slice_step=6)  # doctest: +SKIP
        >>> found = setup.solve()  # doctest: +SKIP
        >>> modified = setup.with_(spline=1.0).solve(start=found)  # doctest: +SKIP
        >>> matcam.inverse.FitSetup((), None)
        Traceback (most recent call last):
        ...
        matcam.core.errors.ArgumentError: at least one table is required, got none: give a table or a list of tables
    """

    tables: tuple[xr.DataArray, ...]
    rig: Rig | None
    ndf: str = "ggx"
    fresnel: FresnelModel = "conductor"
    diffuse: bool = False
    coated: bool = False
    base: bool = False
    per_channel: bool = False
    masking: Masking = "smith"
    camera_parameters: CameraParameters | None = None
    free: tuple[str, ...] = (LENS,)
    also: tuple[str, ...] = ()
    nearby: bool = False
    refitted: tuple[str, ...] = ()
    lens_shape: bool = False
    spline: float = 0.0
    stiff_below: float = 0.0
    learned_spline: float | None = None
    free_masking: bool = False
    noise: PixelNoise | None = None
    slice_step: int = 1
    view: SampleView = FAR_AWAY
    pixels: PixelGrid | None = None
    workspace: Workspace | None = None
    _rule_step: int | None = field(default=None, repr=False)
    """Spacing of the slices of a larger quadrature rule from which the rule of this setup is selected; None: `slice_step`."""

    def __post_init__(self) -> None:
        tables = tuple(checked_table(table) for table in self.tables)
        if not tables:
            raise ArgumentError("at least one table is required, got none: give a table or a list of tables")
        if len({sampling_of(table) for table in tables}) > 1:
            raise ArgumentError("tables that are fitted together must have the same attrs['sampling']")
        checks.choice("ndf", self.ndf, (*FAMILIES, STUDENT, TWO_LOBES))
        checks.choice("fresnel", self.fresnel, tuple(FRESNEL_MODELS))
        checks.choice("masking", self.masking, MASKINGS)
        checks.whole_number("slice_step", self.slice_step, 1, 30)
        checks.scalar("spline", checks.within("spline", self.spline, 0, 10))
        for name in ("diffuse", "coated", "base", "per_channel", "nearby", "lens_shape", "free_masking"):
            checks.flag(name, getattr(self, name))
        checks.instance("workspace", default_workspace() if self.workspace is None else self.workspace, Workspace)
        if self.noise is not None:
            checks.instance("noise", self.noise, PixelNoise).check()
        if self.rig is not None:
            check_rig(self.rig)
            object.__setattr__(self, "rig", located_rig(self.rig, tables[0]).rig)
            for table in tables[1:]:
                rig_behind(table, self.rig)
            colours = len(self.rig.colours)
            if colours > 1 and any(table.sizes["channel"] != colours for table in tables):
                raise ArgumentError(
                    f"a table behind ColourOptics must have {colours} channels, one for each lens, got "
                    f"{', '.join(str(table.sizes['channel']) for table in tables)}"
                )

    def with_(self, **changes: Any) -> FitSetup:
        """Copy the setup with changed fields.

        Args:
            **changes: new values of fields, by name.

        Returns:
            The new setup.

        Raises:
            ArgumentError: a field is out of its range, or a fit does not support the rig.
            FitError: the cells of the first table contradict the rig.
        """
        if "slice_step" in changes:
            changes = {"_rule_step": None, **changes}
        return dataclasses.replace(self, **changes)

    def with_few_slices(self) -> FitSetup:
        """Copy the setup with the slices of a first comparison.

        Starting points and explanations are compared in these few slices. The slices with spacing `SEARCH_STEP` contain
        them, so both share one rule.

        Returns:
            The new setup.

        Example:
            >>> setup.with_few_slices().slice_step  # doctest: +SKIP
            18
        """
        shared = SEARCH_STEP if self.slice_step == SEARCH_STEP else None
        return self.with_(slice_step=max(LOOK_STEP, self.slice_step), _rule_step=shared)

    def solve(self, start: MaterialFit | None = None, *, weights: Literal["data", "start"] = "data") -> MaterialFit:
        """Find the best fit.

        Args:
            start: fit of these tables with another setup, from which the search continues. Default: None, a new search.
                If `start` has the same parameters, for example in fewer slices, a few linear steps suffice.
            weights: source of the first robust weights: "data", the variance of each value, or "start", the weights of
                `start`, which must have the same cells. Default: "data".

        Returns:
            The material, its parameters with their errors, and remarks on the fit.

        Raises:
            ArgumentError: a fit does not support the rig, or the rig lacks a free parameter.
            FitError: the tables do not have enough values to fit, or the fit produced non-finite parameters.
        """
        search = self._search
        if start is None:
            found = self._in_few_slices()
            if found is None:
                return self._result(search.best())
            return self._result(search.widen(found))
        before = start._solution
        weight = before.weight if weights == "start" else None
        same = before.problem.layout == self.layout and before.problem.prior.axes == self.prior.axes
        go_on = search.adjust if same else search.resume
        return self._result(go_on(self._vector(start), weight, before.noise))

    def tempered(self, found: MaterialFit, kappa: float) -> MaterialFit:
        """Increase the errors of a fit whose misfit is correlated between cells.

        Args:
            found: fit with this setup.
            kappa: exponent of the likelihood (no unit), from 0 to 1 (`correction/evidence.py`).

        Returns:
            The same fit, with the covariance of the tempered likelihood.
        """
        return self._result(found._solution.tempered(kappa))

    @property
    def _search(self) -> Search:
        return Search(self.problem, self.noise, self.workspace or default_workspace())

    def _in_few_slices(self) -> Solution | None:
        """Search in a few slices, which takes less time.

        The result is None if the setup itself has only these few slices or fewer, or if the fit in the few slices fails.
        """
        if self.slice_step >= LOOK_STEP:
            return None
        few = self.with_few_slices()
        try:
            return few._search.best(rounds=_LOOK_ROUNDS)
        except FitError:  # the values of the table lie in other slices
            return None

    def _result(self, solution: Solution) -> MaterialFit:
        camera = self.rig.camera if self.rig is not None else None
        return material_fit(solution, camera, noise_given=self.noise is not None)

    def _vector(self, start: MaterialFit) -> np.ndarray:
        """Convert the coordinates of a fit to the layout of this setup. Coordinates that the fit lacks are 0."""
        layout, (problem, p, *_) = self.layout, start._solution
        before = problem.layout
        vector = np.zeros(layout.size)
        size = min(layout.kind.size, before.kind.size)
        for unit, lobe in enumerate(layout.lobe_of):
            vector[layout.lobe(lobe)][:size] = p[before.lobe(before.lobe_of[unit])][:size]
        vector[layout.rig] = p[before.rig] @ axis_selection(problem.prior.axes, self.prior.axes)
        vector[layout.coat] = p[before.coat]
        vector[layout.base_width] = p[before.base_width]
        for name in layout.unit_names:
            vector[layout.of_units(name)] = p[before.of_units(name)]
        return vector

    def rule(self) -> tuple[ChosenCells, tuple[LobeOperator, ...]]:
        """Compute and store the chosen cells and their operators.

        Returns:
            The chosen cells of the slices, and the operators from a lobe to its record in these cells, one for each colour of
            the rig.

        Raises:
            ArgumentError: a fit does not support the rig, or the rig lacks a free parameter.

        Example:
            >>> cells, operators = setup.rule()  # doctest: +SKIP
        """
        sampling = sampling_of(self.tables[0])
        if self.rig is None:
            cells, operator = perfect_operator(sampling, self.slice_step, self.view, self.workspace, self.pixels)
            return cells, (operator,)
        axes, whole = self.prior.axes, self._whole
        cells, operators = zip(
            *(lobe_operator(one, sampling, self.slice_step, axes, self.workspace, whole) for one in self.rig.colours),
            strict=True,
        )
        return cells[0], operators

    @cached_property
    def problem(self) -> FitProblem:
        """Least-squares problem of the fit."""
        layout = self.layout  # computed first, because it checks the arguments
        cells, operators = self.rule()
        radius = (self.view if self.rig is None else sample_view(self.rig)).radius
        return FitProblem(fit_data(self.tables, cells), cells, operators, layout, self.prior, radius)

    @property
    def _whole(self) -> WholeRule:
        """Slices and axes for which the rule is computed, including those of later fits."""
        slice_step, axes = self._rule_step or self.slice_step, self.prior.axes
        refitted = self.with_(also=self.refitted, nearby=True).prior.axes if slice_step >= SEARCH_STEP else axes
        return WholeRule(slice_step, refitted if set(axes) <= set(refitted) else axes)

    @cached_property
    def layout(self) -> Layout:
        """Order of the coordinates of the fit."""
        channels = [table.sizes["channel"] for table in self.tables]
        lobes = range(sum(channels)) if self.per_channel else np.repeat(np.arange(len(channels)), channels)
        kind = LobeKind(self.ndf, self.masking, KNOTS if self.spline else 0, SHADOWS if self.free_masking else 0)
        units = tuple(map(int, lobes))
        return Layout(kind, self.fresnel, self.diffuse, units, len(self.prior.axes), self.base, self.coated)

    @cached_property
    def prior(self) -> Prior:
        """Prior of the coordinates of the fit."""
        camera_parameters = self.camera_parameters
        if self.rig is None:
            if camera_parameters not in (None, "fixed"):
                raise ArgumentError(
                    "without a rig there is no camera to fit: camera_parameters must be None or 'fixed'"
                )
            return Prior(spline=self.spline, finest=self.stiff_below, learned=self.learned_spline)
        check_rig(self.rig)
        known = known_lens(self.rig.camera)
        if camera_parameters is None:
            camera_parameters = "fixed" if known.exact else "prior"
        checks.choice("camera_parameters", camera_parameters, CAMERA_PARAMETERS)
        if camera_parameters == "prior" and known.exact:
            raise ArgumentError(
                "camera_parameters='prior' needs a camera with an uncertainty (Camera(..., uncertainty=...)), but this camera "
                "is exact"
            )
        colours = self.rig.colours
        rig = colours[len(colours) // 2]  # parameters that may be free are common to all colours
        free = [*(self.free if camera_parameters == "free" else ()), *self.also]
        of_lens = [name for name in free if name.startswith("optics.")]
        if len(colours) > 1 and of_lens:
            raise ArgumentError(
                f"a parameter of the lens cannot be free if each colour has its own lens, got {of_lens[0]!r}: use "
                "camera_parameters='prior', which fits a common factor of the widths of all lenses"
            )
        axes: tuple[Axis, ...] = ()
        root = np.zeros((0, 0))
        if camera_parameters == "free":
            axes = tuple(free_axis(name, rig) for name in self.free)
            root = np.zeros((len(axes), len(axes)))
        elif camera_parameters == "prior" and known.uncertainty is not None:
            prior = _stated_prior if len(colours) == 1 else _prior_of_colours
            axes, root = prior(self.rig, known.uncertainty)
        elif camera_parameters == "prior":
            axes, root = (change_axis(WIDTH),), np.array([[1 / CHANGES[WIDTH].std]])
        if self.also:
            axes = (*axes, *(free_axis(name, rig, nearby=self.nearby) for name in self.also))
            root = np.pad(root, ((0, 0), (0, len(self.also))))
        if self.lens_shape:
            shapes, stds = shape_axes(rig)
            axes, root = (*axes, *shapes), block_diag(root, np.diag(1 / np.array(stds)))
        finest = 2 * float(rig.camera.pixel.half_width) / sample_view(rig).radius
        return Prior(axes, root, self.spline, max(finest, self.stiff_below), self.learned_spline)


def _stated_prior(rig: Rig, uncertainty: Uncertainty) -> tuple[tuple[Axis, ...], np.ndarray]:
    """Build the axes of the uncertain parameters of a camera, and a square root of their prior information matrix."""
    parameters = rig.camera.parameters()
    value = np.array([float(parameters[name]) for name in uncertainty.names])
    covariance = np.asarray(uncertainty.covariance)
    uncertain = (np.diag(covariance) > 0) & (value > 0)
    names = [name for name, one in zip(uncertainty.names, uncertain, strict=True) if one]
    relative = covariance[np.ix_(uncertain, uncertain)] / np.outer(value[uncertain], value[uncertain])
    stds = np.sqrt(np.diag(relative)).tolist()
    axes, scales = [], []
    for name, std in zip(names, stds, strict=True):
        axes.append(prior_axis(name, rig, std))
        scales.append(axes[-1].std(std) / std)
    variances, vectors = np.linalg.eigh(relative * np.outer(scales, scales))
    return tuple(axes), (vectors / np.sqrt(np.maximum(variances, 1e-12))).T


def _prior_of_colours(rig: Rig, uncertainty: Uncertainty) -> tuple[tuple[Axis, ...], np.ndarray]:
    """Build the axes of the uncertain parameters of a camera with a lens for each colour, as `_stated_prior` does.

    The widths of all lenses have one common factor. Its standard deviation is the largest of the relative standard deviations
    of the widths, or `ASSUMED` if only other parameters of the lenses are uncertain.
    """
    parameters, stds = rig.camera.parameters(), uncertainty.std()
    widths = [
        std / float(parameters[name]) for name, std in stds.items() if is_lens_width(name) and float(parameters[name])
    ]
    others = any(std > 0 for name, std in stds.items() if name.startswith("optics.") and not is_lens_width(name))
    relative = max(widths, default=ASSUMED if others else 0.0)
    axes, root = _stated_prior(
        rig.colours[0], Uncertainty.of({name: std for name, std in stds.items() if not name.startswith("optics.")})
    )
    if not relative:
        return axes, root
    return (change_axis(WIDTH), *axes), block_diag([[1 / relative]], root)


def fit(
    brdf: xr.DataArray | Sequence[xr.DataArray],
    rig: Rig | None,
    ndf: str = "ggx",
    *,
    fresnel: FresnelModel = "conductor",
    diffuse: bool = False,
    per_channel: bool = False,
    masking: Masking = "smith",
    camera_parameters: CameraParameters | None = None,
    free: Sequence[str] = (LENS,),
    spline: float = 0.0,
    noise: PixelNoise | None = None,
    slice_step: int = 1,
    workspace: Workspace | None = None,
) -> MaterialFit:
    """Fit a microfacet material to a table through its camera.

    All slices of theta_d are fitted jointly. The data are the values of chosen cells, one cell per pixel, so that their errors
    are independent except for the gain of the image. The covariance of the parameters is the inverse of the Fisher
    information, which includes the prior of the camera. Residuals beyond 3 standard deviations have smaller weights (Huber
    1964).

    Args:
        brdf: table of the form that `read_merl` returns, 1/sr, or several tables of one rig, one per material.
        rig: rig that recorded the tables, with a sphere or a cylinder; camera and lamp are distant or near. None: a perfect
            camera.
        ndf: family of the lobe: "ggx", "epd", "sgd", "beckmann" or "gaussian". Default: "ggx". The choice "auto" of `fresnel`
            and `correct` is not allowed, because the family determines the parameters of the result.
        fresnel: model of the Fresnel term F in each channel. "conductor", "schlick" and "dielectric" have parameters, such as n
            and k of a conductor. "free" has one value for each slice. Default: "conductor".
        diffuse: True to add a Lambertian part. Default: False, because metals have none.
        per_channel: True for one lobe per channel. Default: False, one lobe per table.
        masking: model of the masking G of the lobe: "smith", "smith-separable", "van-ginneken", or None for G = 1. Default:
            "smith".
        camera_parameters: treatment of the parameters of the rig. "fixed": the specified values are used. "prior": the
            uncertain parameters of the camera are fitted, and the covariance of the camera is their prior; without a
            covariance, the width of the lens is assumed to be known to 10 %. "free": the parameters named in `free` are
            fitted without a prior. Default: None, "fixed" without a rig or for an exact camera (a standard deviation of 0),
            otherwise "prior".
        free: names of the parameters of the rig that are fitted if `camera_parameters` is "free". A width
            ("optics.sigma_px", "jitter", "aperture", "lamp_radius") may be 0. Default: the width of a Gaussian lens.
        spline: prior standard deviation of the second differences of the spline that modifies the logarithm of the lobe
            (no unit), from 0 to 10. Its knots are spaced by 0.65 in ln(slope) for slopes above 0.0015. Default: 0, no
            modification. With 1, the family hardly constrains the lobe.
        noise: noise of a pixel and of the image gain. Default: None, estimated from the residuals, which include misfit.
        slice_step: spacing of the slices of theta_d that are used (no unit), from 1 to 30. Default: 1, all slices. A larger
            value is faster.
        workspace: store of results that depend only on the rig. Default: None, the store of the process.

    Returns:
        The material, its parameters with their errors, and remarks on the fit.

    Raises:
        ArgumentError: an argument is wrong, or a fit does not support the rig.
        FitError: the tables do not have enough values to fit, the cells contradict the rig, or the fit produced non-finite
            parameters.

    Source:
        docs/model.md sections 3 and 8; variable projection: Golub & Pereyra (1973), Kaufman (1975).

    Example:
        >>> table = matcam.read_merl("chrome.binary")  # doctest: +SKIP
        >>> found = matcam.fit(table, matcam.rigs.merl(), "epd", slice_step=6)  # doctest: +SKIP
        >>> found.params["beta"], found.std["beta"]  # doctest: +SKIP
        >>> matcam.fit([], matcam.rigs.merl())
        Traceback (most recent call last):
        ...
        matcam.core.errors.ArgumentError: at least one table is required, got none: give a table or a list of tables
    """
    if isinstance(free, str):
        raise ArgumentError(f"free must be a list of names, got {free!r}: give [{free!r}]")
    if tuple(free) != (LENS,) and camera_parameters != "free":
        raise ArgumentError(
            f"free has an effect only with camera_parameters='free', got camera_parameters={camera_parameters!r}"
        )
    if rig is not None:
        check_rig(rig)
    given = brdf if isinstance(brdf, list | tuple) else [brdf]
    seen = [without_saturated(checked_table(table), rig) for table in given]  # type: ignore[arg-type]
    setup = FitSetup(
        tables=tuple(table for table, _ in seen), rig=rig,
        ndf=ndf, fresnel=fresnel,
        diffuse=diffuse, per_channel=per_channel, masking=masking, camera_parameters=camera_parameters,
        free=tuple(free), spline=spline, noise=noise, slice_step=slice_step, workspace=workspace,
    )  # fmt: skip
    _ = setup.layout  # checks the arguments before the values
    check_values(setup.tables, setup.rig, slice_step)
    found = setup.solve()
    return dataclasses.replace(found, remarks=(*found.remarks, *(one for _, remarks in seen for one in remarks)))


def free_setup(
    tables: Sequence[xr.DataArray],
    rig: Rig,
    *,
    masking: Masking = "smith",
    camera_parameters: CameraParameters | None = None,
    noise: PixelNoise | None = None,
    slice_step: int = SEARCH_STEP,
    workspace: Workspace | None = None,
) -> FitSetup:
    return FitSetup(
        tuple(tables), rig, fresnel="free", diffuse=True, coated=True, masking=masking, camera_parameters=camera_parameters,
        noise=noise, slice_step=slice_step, workspace=workspace,
    )  # fmt: skip


def candidate_fits(setup: FitSetup, ndf: str) -> list[MaterialFit]:
    return [setup.with_(ndf=family).solve() for family in (CANDIDATES if ndf == AUTO else (ndf,))]
