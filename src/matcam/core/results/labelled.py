"""Labelled results: attributes with name and unit of variables, and the accessor `matcam` of Datasets.

A result that is a Dataset has `result.matcam.summary()` and `result.matcam.plot()` instead of the methods `summary` and
`plot` of other results. Importing this module registers the accessor with xarray.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

import xarray as xr

from matcam.core.errors import ArgumentError
from matcam.core.registry import imported
from matcam.core.results.summary import Summarised, Summary, draw

D = TypeVar("D", xr.Dataset, xr.DataArray)

_COORDINATES = {
    "theta_h": "half angle [rad]",
    "phi_h": "azimuth of the half vector about the normal [rad]",
    "theta_d": "difference angle [rad]",
    "phi_d": "azimuth of the light about the half vector [rad]",
    "theta": "viewing angle of the highlight [rad]",
    "theta_o": "viewing angle [rad]",
    "x": "position to the right [px]",
    "y": "position [px]",
    "frequency": "spatial frequency [cycles/px]",
    "frequency_x": "spatial frequency along the rows [cycles/px]",
    "frequency_y": "spatial frequency across the rows [cycles/px]",
}
"""Long name and unit of the coordinates that results share."""


def named(data: D, texts: Mapping[str, str] | None = None) -> D:
    """Add the attributes `long_name` and `units` to variables and coordinates.

    xarray uses these attributes in plots, and NetCDF files contain them.

    Args:
        data: a new result. The attributes are set in place; an existing `long_name` or `units` is kept.
        texts: long name and unit of each variable and coordinate, such as "BRDF [1/sr]". Without a unit, `units` is
            "1", as in the CF conventions. Default: None, only the coordinates that results share are named.

    Returns:
        `data`.

    Example:
        >>> import xarray as xr
        >>> named(xr.Dataset({"a": ("theta_d", [1.0])}, {"theta_d": [0.5]}), {"a": "share of light"})["a"].attrs
        {'long_name': 'share of light', 'units': '1'}
    """
    for name, text in {**_COORDINATES, **(texts or {})}.items():
        if name in data.coords or (isinstance(data, xr.Dataset) and name in data.data_vars):
            words, _, unit = text.removesuffix("]").partition(" [")
            attrs = data[name].attrs
            data[name].attrs = {"long_name": words, "units": unit or "1", **attrs}
    return data


_KINDS = {
    "Fresnel term": ({"raw", "corrected", "supported_angle"}, "matcam.inverse.dataset_summaries:fresnel_summary"),
    "corrected table": (
        {"brdf", "correction_std", "supported"},
        "matcam.inverse.dataset_summaries:corrected_summary",
    ),
    "bounds": ({"width_std", "lens_std_free", "fresnel_std"}, "matcam.inverse.dataset_summaries:bounds_summary"),
    "prediction": (
        {"response", "relative_response", "loss_angle"},
        "matcam.forward.prediction:prediction_summary",
    ),
}
"""Kinds of Datasets: variables that only this kind has all of, and function that summarises it, imported on first use."""


@xr.register_dataset_accessor("matcam")
class DatasetAccessor(Summarised):
    """Summary and figure of a Dataset that matcam has made: `result.matcam.summary()`, `result.matcam.plot()`.

    Args:
        data: a result of `fresnel`, `correct`, `limits` or `predict`, from memory or from a file.
    """

    def __init__(self, data: xr.Dataset):
        self._data = data

    @property
    def kind(self) -> str:
        """Kind of the result: "Fresnel term", "corrected table", "bounds" or "prediction".

        An ArgumentError is raised for any other Dataset.
        """
        names = set(map(str, self._data.variables))
        found = [kind for kind, (variables, _) in _KINDS.items() if variables <= names]
        if not found:
            raise ArgumentError(
                "summary and plot need a result of fresnel, correct, limits or predict, but this Dataset lacks the variables "
                "of these results"
            )
        return found[0]

    def _summary(self) -> Summary:
        return imported(_KINDS[self.kind][1])(self._data)

    def plot(self, ax: Any = None, **options: Any) -> Any:
        """Draw the result; see `Summarised.plot`."""
        return draw(self.kind, self._data, ax, options)
