"""Recipe of a run: rig and options, the correction of one table, and the key that identifies the records of the run.

The blur of the camera may be fitted jointly to a few materials of the run, because one rig recorded all materials.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from matcam.camera.camera import Camera
from matcam.camera.parameters import Provenance
from matcam.core.errors import FitError, MatcamError
from matcam.core.grid import Sampling
from matcam.core.io import plain
from matcam.core.workspace import Workspace
from matcam.exchange.contents import read_table
from matcam.exchange.inspection import lobe_widths
from matcam.inverse.correction.correction import Correction
from matcam.inverse.fit.fit_setup import candidate_fits, free_setup
from matcam.inverse.rig.rig_axes import LENS, known_lens
from matcam.material.masking import Masking
from matcam.numerics.budget import UncertaintyBudget
from matcam.rigs import Rig

SETTINGS_FORMAT = "matcam run"


class Options(NamedTuple):
    """Options of a correction.

    Attributes:
        ndf: family of the lobe, or "auto" for the more probable of "ggx" and "epd". Default: "auto".
        masking: masking function; None: no masking. Default: "smith".
        glare: share of light in an unspecified halo of the lens (no unit). Default: 1e-3.
        force_correction: True to correct tables even if their data contradict the rig. Default: False, such tables are not
            changed.
        workspace: cache of results that depend on the rig alone. The cache does not affect results. Default: None, the
            cache of the process.

    Example:
        >>> matcam.batch.Options(ndf="ggx").glare
        0.001
    """

    ndf: str = "auto"
    masking: Masking = "smith"
    glare: float = 1e-3
    force_correction: bool = False
    workspace: Workspace | None = None


class CorrectedTable(NamedTuple):
    """Result of a corrector.

    Attributes:
        table: Dataset (brdf, brdf_std, correction_std, noise_std, supported, response).
        document: record of the table, in types of JSON.
        write_page: function (path, name, force) that writes the page of the material.
        budgets: uncertainty budgets of the peaks. Default: ().
    """

    table: xr.Dataset
    document: dict[str, Any]
    write_page: Callable[[Path, str, bool], None]
    budgets: tuple[UncertaintyBudget, ...] = ()


Corrector = Callable[[xr.DataArray, Rig, Options], CorrectedTable]
"""Type of a function that corrects one table. Workers import it by name, so it must be at the top level of a module."""


def correct_table(table: xr.DataArray, rig: Rig, options: Options) -> CorrectedTable:
    """Correct a table for its camera. The exceptions are those of `correct`."""
    done = Correction.of(
        table,
        rig,
        options.ndf,
        masking=options.masking,
        glare=options.glare,
        force_correction=options.force_correction,
        workspace=options.workspace,
    )
    document = {"camera": rig.camera.profile(), "glare": options.glare, **done.to_dict()}

    def write_page(path: Path, name: str, force: bool) -> None:
        from matcam.figures.pages import write_correction_page  # Matplotlib is imported only for drawing

        write_correction_page(path, table, done, name, force=force)

    return CorrectedTable(done.table, document, write_page, tuple(done.uncertainty_budgets()))


@dataclass(frozen=True)
class Recipe:
    """Rig and settings for every table of a run.

    Attributes:
        rig: the rig that recorded the tables.
        options: options of the correction.
        sampling: sampling position of a value in its cell. Default: "centre".
        page: True to write a page for each table. Default: True.
        compress: True to compress the NetCDF files. Default: True.
        corrector: function that corrects one table. Default: `correct_table`.
        version: version of matcam that created the recipe. Workers with another version reject the recipe. Default: the
            installed version.
    """

    rig: Rig
    options: Options
    sampling: Sampling = "centre"
    page: bool = True
    compress: bool = True
    corrector: Corrector = correct_table
    version: str = field(default_factory=lambda: metadata.version("matcam"))

    def settings(self, *, fit_camera: bool) -> dict[str, Any]:
        return plain(
            {
                "format": SETTINGS_FORMAT,
                "matcam": self.version,
                "corrector": f"{self.corrector.__module__}:{self.corrector.__qualname__}",
                "rig": rig_description(self.rig),
                "ndf": self.options.ndf,
                "masking": self.options.masking or "none",
                "glare": self.options.glare,
                "force_correction": self.options.force_correction,
                "sampling": self.sampling,
                "pages": self.page,
                "compress": self.compress,
                "fit_camera": fit_camera,
            }
        )

    def in_words(self) -> str:
        family = "GGX or EPD, the more probable" if self.options.ndf == "auto" else self.options.ndf
        source = self.rig.camera.provenance.source
        return (
            f"Lobe: {family}; masking: {self.options.masking or 'none'}; {self.rig.sample.in_words()}; "
            f"camera: {known_lens(self.rig.camera).words}{f'; source of the camera: {source}' if source else ''}."
        )


def rig_description(rig: Rig) -> dict[str, Any]:
    described = rig.description()
    described["camera"].pop("provenance")  # contains the current date, which does not affect results
    azimuth = {} if rig.lamp_azimuth is None else {"lamp_azimuth": rig.lamp_azimuth}
    return {**described, "crop": rig.crop, "cell_value": rig.cell_value, "pixel_phase": rig.pixel_phase, **azimuth}


def settings_key(settings: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(plain(settings), sort_keys=True).encode()).hexdigest()[:32]


def fit_shared_camera(recipe: Recipe, inputs: Sequence[Path]) -> Camera:
    """Fit the blur of the recipe's camera jointly to the inputs with the narrowest lobes.

    The fitted camera includes the variance of the blur. A FitError is raised if none of the selected inputs can be read, or
    if the tables do not determine the blur to 25 %.
    """
    chosen = _narrowest(inputs, recipe.sampling)
    tables = [table for _, table in chosen]
    options = recipe.options
    setup = free_setup(
        tables, recipe.rig, masking=options.masking, camera_parameters="free", workspace=options.workspace
    )
    best = max(candidate_fits(setup, options.ndf), key=lambda found: found.log_likelihood)
    value, std = best.params[LENS], best.std[LENS]
    names = ", ".join(file.name for file, _ in chosen)
    camera = best.camera
    # a correction assumes that the relative standard deviation of the blur is small
    if camera is None or not std < 0.25 * value:
        raise FitError(
            f"the tables {names} do not determine the camera's blur ({value:.3g} ± {std:.2g} px): specify the camera's "
            "profile in the rig instead of fit_camera=True, or give tables with narrower lobes"
        )
    source = Provenance(
        source=f"blur fitted jointly to {names}, a {best.family} lobe for each", notes="; ".join(map(str, best.remarks))
    )
    return replace(camera, provenance=source)


def _narrowest(inputs: Sequence[Path], sampling: Sampling) -> list[tuple[Path, xr.DataArray]]:
    """Select the 4 tables with the narrowest lobes from 16 evenly selected inputs.

    A broad lobe contains little information about the lens. Unreadable tables are skipped, because their own jobs report
    the errors. A FitError is raised if none of the 16 inputs can be read.
    """
    positions = np.unique(np.linspace(0, max(len(inputs) - 1, 0), min(16, len(inputs))).astype(int))
    widths: list[tuple[float, Path]] = []
    for position in positions:
        try:
            table = read_table(inputs[position], sampling=sampling)
        except MatcamError:
            continue
        across = lobe_widths(table).across
        width = float(np.nanmedian(across)) if np.isfinite(across).any() else np.inf
        widths.append((width, inputs[position]))
    if not widths:
        raise FitError(
            f"no table can be read, but fit_camera=True requires one readable table among {len(positions)} evenly selected "
            "inputs: give readable tables"
        )
    narrowest = sorted(widths, key=lambda entry: entry[0])[:4]
    return [(file, read_table(file, sampling=sampling)) for _, file in narrowest]
