"""What nobody can know from a rig's pictures: Cramer-Rao bounds, and blurs that look alike (MODEL 8)."""

from __future__ import annotations

from collections.abc import Sequence

import equinox as eqx
import numpy as np
import xarray as xr

from matcam.camera.sensor import PixelNoise
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.grid import Sampling
from matcam.core.jax import jnp
from matcam.inverse.fit.lobe_slopes import lobe_and_slope
from matcam.inverse.operator.chosen_cells import ChosenCells
from matcam.inverse.operator.lobe_operator import check_rig, lobe_operator
from matcam.inverse.operator.rig_axes import LENS, known_axis
from matcam.material.registry import ONE_WIDTH
from matcam.rigs import Rig
from matcam.sample.sphere import Sphere

DETERMINED = 0.05
ROUGHNESSES = (0.0003, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2)
_STEP = 0.004

BLURS: dict[str, tuple[str, float]] = {
    "lamp (degrees)": ("lamp_radius", float(np.radians(0.15))),
    "jitter (px)": ("jitter", 0.15),
    "defocus (aperture / distance)": ("aperture", 0.004),
}
"""What else widens a highlight: field of `Rig`, and the size at which its signature is taken."""


def limits(
    rig: Rig,
    roughness: Sequence[float] = ROUGHNESSES,
    ndf: str = "ggx",
    *,
    noise: PixelNoise | None = None,
    every: int = 10,
) -> xr.Dataset:
    """Which roughness and which angle a rig can recover at all, what mimics its lens, and what to change.

    rig: a distant camera with a Gaussian lens ("optics.sigma_px") and a sphere. roughness: of lobes of the one-width family
    `ndf`. noise: of a pixel and of a picture's gain. every: use every n-th theta_d of a table; the bounds shrink with more.
    F is free in every picture.

    Dataset over roughness, theta_d (rad), blur and change:
      width_std            Cramer-Rao bound of ln roughness, camera exact
      width_std_stated     the same with the lens known as its profile says (NaN where it says nothing)
      width_std_free       the same with the lens left free
      lens_std_free        bound of ln sigma_mtf then
      fresnel_std          of F at each theta_d, relative, lens as stated, else exact; pixel noise and lens, without gain
      alike                (roughness, blur): correlation of what a blur changes with what a wider lens changes, all that
                           roughness and F can take up set aside: 1 cannot be told apart
      smallest             (roughness, blur): size at which the blur is told at 3 standard deviations, lens free
      width_bias           (roughness, blur): change of ln roughness if a blur of the size in `size` is there and ignored,
                           lens exact
      width_std_changed    (roughness, change): width_std_free, and width_std if the lens is exact, after a change

    ArgumentError for a rig that a fit would refuse, or for another lens.
    """
    check_rig(rig)
    checks.choice("ndf", ndf, tuple(ONE_WIDTH))
    if LENS not in rig.camera.parameters():
        raise ArgumentError("limits need a camera whose lens is a Gaussian: it has no 'optics.sigma_px'")
    values = np.asarray(checks.within("roughness", np.asarray(roughness, dtype=object), 1e-5, ONE_WIDTH[ndf].largest))
    if values.ndim != 1 or not values.size:
        raise ArgumentError(f"roughness must be a list of at least one number, got shape {values.shape}")
    assumed = (noise or PixelNoise(picture_gain=0.01)).checked()
    known = rig.camera.uncertainty.std().get(LENS, np.nan) if rig.camera.uncertainty else np.nan
    relative = known / float(rig.camera.parameters()[LENS])
    own = [_Information(rig, ndf, a, assumed, every) for a in values]
    rest: dict[str, tuple[tuple[str, ...], np.ndarray]] = {}
    stated = [i.std(relative) if np.isfinite(relative) else np.array([np.nan, np.nan]) for i in own]
    rest["width_std"] = ("roughness",), np.array([i.std(0.0)[0] for i in own])
    rest["width_std_stated"] = ("roughness",), np.array([s[0] for s in stated])
    rest["width_std_free"] = ("roughness",), np.array([i.std(np.inf)[0] for i in own])
    rest["lens_std_free"] = ("roughness",), np.array([i.std(np.inf)[1] for i in own])
    prior = relative if np.isfinite(relative) else 0.0
    rest["fresnel_std"] = ("roughness", "theta_d"), np.array([i.fresnel_std(prior) for i in own])
    signatures = [[_signature(rig, ndf, a, i, field, size, assumed, every) for field, size in BLURS.values()]
                  for a, i in zip(values, own, strict=True)]  # fmt: skip
    for name, column in zip(("alike", "smallest", "width_bias"), np.array(signatures).transpose(2, 0, 1), strict=True):
        rest[name] = ("roughness", "blur"), column
    changes = changed_rigs(rig)
    rest["width_std_changed"] = (
        ("roughness", "change", "lens"),
        np.array(
            [
                [
                    (lambda i: (i.std(0.0)[0], i.std(np.inf)[0]))(_Information(r, ndf, a, assumed, every))
                    for r in changes.values()
                ]
                for a in values
            ]
        ),
    )
    cells = own[0].cells
    return xr.Dataset(
        rest,
        coords={
            "roughness": values,
            "theta_d": ("theta_d", cells.theta_d, {"units": "rad"}),
            "blur": list(BLURS),
            "size": ("blur", [float(np.degrees(s)) if f == "lamp_radius" else s for f, s in BLURS.values()]),
            "change": list(changes),
            "lens": ["exact", "free"],
        },
        attrs={"ndf": ndf, "noise": str(tuple(assumed)), "every": every, "lens_std_stated": float(relative)},
    )


def changed_rigs(rig: Rig) -> dict[str, Rig]:
    """What a user can change, each by itself."""
    radius, sigma = float(rig.sample.radius), float(rig.camera.parameters()[LENS])  # type: ignore[attr-defined]

    def with_(radius: float, sigma: float) -> Rig:
        lens = rig.camera.with_parameters({LENS: sigma})
        return eqx.tree_at(lambda r: (r.sample, r.camera), rig, (Sphere(radius), lens))

    return {
        "sphere twice as large in the picture": with_(2 * radius, sigma),
        "lens half as blurred (aperture, focus)": with_(radius, sigma / 2),
        "twice the pixels, same lens": with_(2 * radius, 2 * sigma),
    }


class _Information:
    """Fisher information of ln roughness and ln sigma_mtf in the chosen cells, F free in every picture."""

    def __init__(self, rig: Rig, ndf: str, roughness: float, noise: PixelNoise, every: int):
        sampling: Sampling = "edge" if rig.cell_value == "edge" else "centre"
        cells, operator = lobe_operator(
            rig, sampling, every, (known_axis(LENS, float(rig.camera.parameters()[LENS]), _STEP),)
        )
        at = jnp.array([np.log(roughness), 0.0])
        record, slopes = (np.asarray(a) for a in lobe_and_slope(operator, ndf, "smith", at, 1))
        peak = record.max(-1, keepdims=True, where=cells.kept, initial=0)
        share = np.where(cells.one_pixel, 1.0, 0.5)
        used = cells.kept & (peak > 0)
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
        """A change of the record in standard deviations, without what free strengths take up."""
        u = column * self.root
        return u - self.direction * (u * self.direction).sum(-1, keepdims=True)

    def _matrix(self, prior: float) -> np.ndarray:
        flat = self.columns.reshape(2, -1)
        information = flat @ flat.T
        if np.isfinite(prior):
            information[1, 1] += 1 / max(prior, 1e-9) ** 2
        return np.linalg.pinv(information, rcond=1e-14, hermitian=True)

    def std(self, prior: float) -> np.ndarray:
        """Of (ln roughness, ln sigma_mtf); prior: standard deviation of the latter, 0 exact, infinite free."""
        return np.sqrt(np.diag(self._matrix(prior)))

    def fresnel_std(self, prior: float) -> np.ndarray:
        """Relative, of F in every picture: its own pixels' noise, and roughness and lens through the lobe."""
        taken = ((self.slopes * self.root) * self.direction).sum(-1) / np.where(self.length > 0, self.length, np.inf)
        shared = np.einsum("ps,pq,qs->s", taken, self._matrix(prior), taken)
        return np.sqrt(np.where(self.length > 0, 1 / np.maximum(self.length, 1e-300) ** 2 + shared, np.inf))


def _signature(
    rig: Rig, ndf: str, roughness: float, own: _Information, field: str, size: float, noise: PixelNoise, every: int
) -> tuple[float, float, float]:
    """(alike, smallest, width_bias) of one blur."""
    blurred = eqx.tree_at(lambda r: getattr(r, field), rig, jnp.asarray(size))
    other = _Information(blurred, ndf, roughness, noise, every)
    change = own.free(other.record - own.record).ravel()
    width, lens = own.columns.reshape(2, -1)
    exact = float(change @ width / (width @ width))

    def aside(column: np.ndarray) -> np.ndarray:
        return column - width * (column @ width) / (width @ width)

    seen, of_lens = aside(change), aside(lens)
    sizes = np.sqrt((seen @ seen) * (of_lens @ of_lens))
    alike = float(seen @ of_lens / sizes) if sizes > 0 else 1.0
    left = seen - of_lens * (seen @ of_lens) / max(of_lens @ of_lens, 1e-300)
    strength = float(np.sqrt(left @ left))  # standard deviations at `size`; a blur adds variance: it goes as size^2
    smallest = size * np.sqrt(3 / strength) if strength > 1e-6 else np.inf
    return alike, float(np.degrees(smallest)) if field == "lamp_radius" else smallest, exact
