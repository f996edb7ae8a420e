"""Cramer-Rao bounds of roughness and Fresnel term for the images of a rig, and correlations of blurs (docs/model.md 8)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np
import xarray as xr

from matcam.camera.sensor import PixelNoise
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.grid import Sampling
from matcam.core.registry import ONE_WIDTH
from matcam.core.results.labelled import named
from matcam.core.workspace import Workspace
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.inverse.fit.lobe_slopes import record_and_slopes
from matcam.inverse.operator.chosen_cells import ChosenCells
from matcam.inverse.operator.lobe_operator import check_rig, lobe_operator
from matcam.inverse.operator.sphere_rule import kernel_reach
from matcam.inverse.operator.theta_nodes import NARROWEST, Scale
from matcam.inverse.rig.rig_axes import LAMP, LENS, Axis, rig_with, widths_of
from matcam.numerics.linalg import scaled_inverse
from matcam.rigs import Rig

ROUGHNESSES = (0.0003, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2)
"""Default roughnesses for which bounds are computed, no unit. They range from highlights far below a pixel to broad lobes."""

_STEP = 0.02
"""Half the range of the logarithm of the lens width. The bounds require only derivatives, so a short range suffices."""
_SEEN = 3.0
"""Effect of a blur, in standard deviations, at which the blur is detected. A false detection has a probability
of 0.3 %.
"""

BLURS: dict[str, tuple[str, float]] = {
    "lamp (degrees)": (LAMP, float(np.radians(0.15))),
    "jitter (px)": ("jitter", 0.15),
    "defocus (aperture / distance)": ("aperture", 0.004),
}
"""Blurs of a highlight other than that of the lens, by name: field of `Rig`, and largest size for which the effect is computed,
in the unit of the field.
"""
_LARGEST_BLUR = 0.2
"""Largest size of a lamp or a defocus for which the effect is computed, px in the image. Effects are scaled with the square of
the size, which holds for blurs much smaller than that of the lens. The smallest detectable lamp then differs by at most 4 %
from the limit for small lamps (16 % with 2 px), for lobes of 0.001 to 0.02 on a sphere of 400 px.
"""
_NAMES = {
    "width_std": "bound of ln roughness, lens exact",
    "width_std_stated": "bound of ln roughness, lens as specified by its profile",
    "width_std_free": "bound of ln roughness, lens free",
    "lens_std_free": "bound of ln sigma_mtf, lens free",
    "fresnel_std": "bound of F, relative",
    "correlation": "correlation of the effect of a blur with that of a wider lens",
    "smallest": "size of a blur that is detected at 3 standard deviations [unit in the name of the blur]",
    "width_bias": "change of ln roughness that an ignored blur causes",
    "width_std_changed": "bound of ln roughness after a change of the rig",
    "size": "size of the blur [unit in the name of the blur]",
}
"""Descriptive names and units of the variables of the result."""


def limits(
    rig: Rig,
    ndf: str = "ggx",
    *,
    roughness: Sequence[float] = ROUGHNESSES,
    noise: PixelNoise | None = None,
    slice_step: int = 10,
    workspace: Workspace | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> xr.Dataset:
    """Compute Cramer-Rao bounds of roughness and Fresnel term for a rig.

    The result also contains the effects of other blurs, which may resemble the blur of the lens, and of changes of the rig.
    The Fresnel term F is free in every slice, and constant within a slice. Masking is Smith's, because there are no data to
    choose another model.

    Args:
        rig: camera with a Gaussian lens, a sphere or cylinder, and a lamp; camera and lamp are distant or near.
        ndf: family of the lobe, with roughness as its only parameter: "gaussian", "ggx" or "beckmann". Default: "ggx".
        roughness: roughnesses, (n,), no unit, or rad for a Gaussian lobe. The quadrature resolves roughnesses from 2.5e-4,
            and smaller ones on large samples. Default: ten values from 0.0003 to 0.2.
        noise: noise of a pixel and of the image gain. Default: None, 1 % of the value, 1e-4 of the peak and 1 % of gain.
        slice_step: spacing of the slices of theta_d (no unit), from 1 to 30. Default: 10, unlike `fit`, because few slices
            suffice to compare rigs. Bounds decrease with more slices.
        workspace: store of results that depend only on the rig. Default: None, the store of the process.
        progress: function that is called with the name of the step, the number of rigs that are finished, and the number of
            all rigs, which include those with another blur and the changed ones. Default: None.

    Returns:
        Dataset over roughness, theta_d (rad), blur and change. The bounds are for one channel. If the channels of a table have
        one lobe and independent noise, bounds of roughness and lens decrease with the square root of their number:

        - `width_std`: bound of the standard deviation of ln roughness if the lens is exact.
        - `width_std_stated`: the same bound for the uncertainty of the lens that the camera specifies; NaN if there is none.
        - `width_std_free`: the same bound if the width of the lens is free.
        - `lens_std_free`: bound of the standard deviation of the logarithm of the lens width if this width is free.
        - `fresnel_std`: bound of the relative standard deviation of F at each theta_d, without the image gain. The lens has the
            uncertainty that the camera specifies. If the camera specifies none, the lens is exact.
        - `correlation`, (roughness, blur): correlation between the effects of a blur and of a wider lens, after roughness and
            F are fitted. If it is 1, the effects cannot be distinguished.
        - `smallest`, (roughness, blur): size, in the unit in the name of the blur, at which the blur is detected at 3 standard
            deviations if the lens is free.
        - `width_bias`, (roughness, blur): change of ln roughness if a blur of the size in `size` exists and is ignored, for an
            exact lens.
        - `width_std_changed`, (roughness, change, lens): `width_std` and `width_std_free` after a change of the rig.

    Raises:
        ArgumentError: a fit does not support the rig, the lens is not Gaussian, or an argument is out of its range.

    Source:
        docs/model.md section 8.

    Example:
        >>> matcam.limits(matcam.rigs.merl(), roughness=[0.002])["width_std"]  # doctest: +SKIP
        >>> matcam.limits(matcam.rigs.merl(), roughness=[])
        Traceback (most recent call last):
        ...
        matcam.core.errors.ArgumentError: roughness must be a list of at least one number, got shape (0,)
    """
    check_rig(rig)
    checks.whole_number("slice_step", slice_step, 1, 30)
    checks.choice("ndf", ndf, tuple(ONE_WIDTH))
    if LENS not in rig.camera.parameters():
        raise ArgumentError(
            f"limits requires a camera with a Gaussian lens, got {type(rig.camera.optics).__name__}: give the lens of one "
            "colour, or a GaussianOptics that is as wide as this lens"
        )
    sigma, half_width = float(rig.camera.parameters()[LENS]), float(rig.camera.pixel.half_width)
    size = float(rig.sample.radius)  # type: ignore[attr-defined]
    least = NARROWEST * Scale.of(size, float(kernel_reach(half_width, np.asarray(sigma)))).largest
    why = "(the quadrature nodes resolve lobes in this range)"
    given = np.asarray(roughness, dtype=object)
    values = np.asarray(checks.within("roughness", given, least, ONE_WIDTH[ndf].largest, why))
    if values.ndim != 1 or not values.size:
        raise ArgumentError(f"roughness must be a list of at least one number, got shape {values.shape}")
    noise = PixelNoise(picture_gain=0.01) if noise is None else checks.instance("noise", noise, PixelNoise)
    blurs = {
        name: (field, most if field == "jitter" else min(most, _LARGEST_BLUR / size))
        for name, (field, most) in BLURS.items()
        if field in widths_of(rig)
    }
    changes = changed_rigs(rig)
    tell, count = progress or (lambda *_: None), 1 + len(blurs) + len(changes)
    steps = iter(range(count))

    def begin() -> None:
        tell("computing the bounds", next(steps), count)

    view = _View(ndf, noise.check(), slice_step, workspace, begin)
    stated_std = rig.camera.uncertainty.std().get(LENS, np.nan) if rig.camera.uncertainty else np.nan
    relative = stated_std / sigma
    own = _informations(view, rig, values)
    variables: dict[str, tuple[tuple[str, ...], np.ndarray]] = {}
    stated = [i.std(relative) if np.isfinite(relative) else np.array([np.nan, np.nan]) for i in own]
    variables["width_std"] = ("roughness",), np.array([i.std(0.0)[0] for i in own])
    variables["width_std_stated"] = ("roughness",), np.array([s[0] for s in stated])
    variables["width_std_free"] = ("roughness",), np.array([i.std(np.inf)[0] for i in own])
    variables["lens_std_free"] = ("roughness",), np.array([i.std(np.inf)[1] for i in own])
    prior = relative if np.isfinite(relative) else 0.0
    variables["fresnel_std"] = ("roughness", "theta_d"), np.array([i.fresnel_std(prior) for i in own])
    signatures = np.array(
        [_signatures(view, rig_with(rig, {field: most}), own, values, field, most) for field, most in blurs.values()]
    )
    for name, column in zip(("correlation", "smallest", "width_bias"), signatures.transpose(2, 1, 0), strict=True):
        variables[name] = ("roughness", "blur"), column
    variables["width_std_changed"] = (
        ("roughness", "change", "lens"),
        np.array([[_exact_and_free(i) for i in _informations(view, r, values)] for r in changes.values()]).swapaxes(
            0, 1
        ),
    )
    cells = own[0].cells
    found = xr.Dataset(
        variables,
        coords={
            "roughness": values,
            "theta_d": cells.theta_d,
            "blur": list(blurs),
            "size": ("blur", [float(np.degrees(s)) if f == LAMP else s for f, s in blurs.values()]),
            "change": list(changes),
            "lens": ["exact", "free"],
        },
        attrs={
            "ndf": ndf,
            "noise_relative": view.noise.relative,
            "noise_floor": view.noise.floor,
            "picture_gain": view.noise.picture_gain,
            "slice_step": slice_step,
            "lens_std_stated": float(relative),
        },
    )
    unit = "rad" if ndf == "gaussian" else "1"
    return named(found, _NAMES | {"roughness": f"roughness of the {ndf} lobe [{unit}]"})


def changed_rigs(rig: Rig) -> dict[str, Rig]:
    """Build feasible variants of a rig, and name them.

    The variants differ from the rig in the radius in the image, in the width of the lens, or in both.
    """
    radius, sigma = float(rig.sample.radius), float(rig.camera.parameters()[LENS])  # type: ignore[attr-defined]

    def with_(radius: float, sigma: float) -> Rig:
        lens = rig.camera.with_parameters({LENS: sigma})
        distance = {} if rig.sample.distant else {"distance": rig.sample.distance}  # type: ignore[attr-defined]
        return eqx.tree_at(lambda r: (r.sample, r.camera), rig, (type(rig.sample)(radius, **distance), lens))  # type: ignore[call-arg]

    return {
        f"{rig.sample.kind} twice as large in the image": with_(2 * radius, sigma),
        "lens half as blurred (aperture, focus)": with_(radius, sigma / 2),
        "twice the pixels, same lens": with_(2 * radius, 2 * sigma),
    }


class _View(NamedTuple):
    """Conditions, other than rig and roughness, for which bounds are computed. `begin` is called before each rig."""

    ndf: str
    noise: PixelNoise
    slice_step: int
    workspace: Workspace | None
    begin: Callable[[], None]


def _records(
    view: _View, rig: Rig, roughness: np.ndarray, axes: tuple[Axis, ...]
) -> tuple[ChosenCells, list[tuple[np.ndarray, np.ndarray]]]:
    """Choose cells, and compute their records and the derivatives of the records for each roughness.

    The derivatives are with respect to ln roughness and the coordinates of the axes.
    """
    view.begin()
    sampling: Sampling = "edge" if rig.cell_value == "edge" else "centre"
    cells, operator = lobe_operator(rig, sampling, view.slice_step, axes, view.workspace)
    lobe, at = LobeKind(view.ndf, "smith"), np.zeros(len(axes))
    return cells, [record_and_slopes(operator, lobe, np.array([np.log(a), *at])) for a in roughness]


def _informations(view: _View, rig: Rig, roughness: np.ndarray) -> list[_Information]:
    """Compute the information in the record of a rig for each roughness."""
    axis = Axis(LENS, float(rig.camera.parameters()[LENS]), 0.0, -_STEP, _STEP, (-_STEP, 0.0, _STEP))
    cells, records = _records(view, rig, roughness, (axis,))
    return [_Information(view.noise, cells, *one) for one in records]


class _Information:
    """Fisher information of the logarithms of roughness and lens width in the chosen cells, with F free in every slice."""

    def __init__(self, noise: PixelNoise, cells: ChosenCells, record: np.ndarray, slopes: np.ndarray):
        peak = record.max(-1, keepdims=True, where=cells.valid, initial=0)
        share = cells.noise_share
        used = cells.valid & (peak > 0)
        variance = share * ((noise.relative * record) ** 2 + (noise.floor * peak) ** 2)
        self.root = np.where(used, 1 / np.sqrt(np.where(used, variance, 1.0)), 0.0)
        a = record * self.root
        length = np.sqrt((a**2).sum(-1, keepdims=True))
        self.direction = a / np.where(length > 0, length, 1.0)
        self.length = length[:, 0]
        self.cells: ChosenCells = cells
        self.record = record
        self.slopes = slopes
        self.columns = self.free(slopes)

    def free(self, column: np.ndarray) -> np.ndarray:
        """Project a change of the record orthogonally to the free strengths.

        The change is first divided by the standard deviation of the noise.
        """
        u = column * self.root
        return u - self.direction * (u * self.direction).sum(-1, keepdims=True)

    def _matrix(self, prior: float) -> np.ndarray:
        flat = self.columns.reshape(2, -1)
        information = flat @ flat.T
        if np.isfinite(prior):
            information[1, 1] += 1 / max(prior, 1e-9) ** 2
        return scaled_inverse(information)

    def std(self, prior: float) -> np.ndarray:
        """Compute bounds of the standard deviations of the logarithms of roughness and lens width, (2,).

        prior: prior standard deviation of the logarithm of the lens width; infinite for a free lens.
        """
        return np.sqrt(np.diag(self._matrix(prior)))

    def fresnel_std(self, prior: float) -> np.ndarray:
        """Compute bounds of the relative standard deviation of F, (slices,).

        Pixel noise, roughness and lens contribute. The bound is infinite for slices without used cells.

        prior: prior standard deviation of the logarithm of the lens width; infinite for a free lens.
        """
        length = np.where(self.length > 0, self.length, np.inf)
        by_lobe = ((self.slopes * self.root) * self.direction).sum(-1) / length
        shared = np.einsum("ps,pq,qs->s", by_lobe, self._matrix(prior), by_lobe)
        return np.where(self.length > 0, np.sqrt(1 / length**2 + shared), np.inf)


def _exact_and_free(information: _Information) -> tuple[float, float]:
    return information.std(0.0)[0], information.std(np.inf)[0]


def _signatures(
    view: _View, rig: Rig, own: list[_Information], roughness: np.ndarray, field: str, size: float
) -> list[tuple[float, float, float]]:
    """Compute correlation, smallest size and bias of one blur for each roughness, as in `limits`.

    `field` is the field of `rig` that causes the blur, and `size` is the value of this field in its unit. The smallest size of
    a lamp is in degrees.
    """
    _, blurred = _records(view, rig, roughness, ())
    found = []
    for one, (record, _) in zip(own, blurred, strict=True):
        correlation, smallest, bias = _signature(one, record, size)
        found.append((correlation, float(np.degrees(smallest)) if field == LAMP else smallest, bias))
    return found


def _signature(own: _Information, blurred: np.ndarray, size: float) -> tuple[float, float, float]:
    """Compute correlation, smallest size and bias of a blur of a size, whose record is `blurred`."""
    change = own.free(blurred - own.record).ravel()
    width, lens = own.columns.reshape(2, -1)
    exact = float(change @ width / (width @ width))

    def without_width(column: np.ndarray) -> np.ndarray:
        return column - width * (column @ width) / (width @ width)

    by_blur, by_lens = without_width(change), without_width(lens)
    sizes = np.sqrt((by_blur @ by_blur) * (by_lens @ by_lens))
    correlation = float(by_blur @ by_lens / sizes) if sizes > 0 else 1.0
    left = by_blur - by_lens * (by_blur @ by_lens) / max(by_lens @ by_lens, 1e-300)
    deviations = float(np.sqrt(left @ left))  # at `size`; a blur adds variance, so they scale with size^2
    smallest = size * np.sqrt(_SEEN / deviations) if deviations > 1e-6 else np.inf
    return correlation, smallest, exact
