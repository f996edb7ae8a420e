"""Optical constants of metals, from published tables (CC0, refractiveindex.info) included in the package."""

from __future__ import annotations

from functools import cache
from importlib import resources
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from matcam.core import checks
from matcam.core.errors import ArgumentError, unknown_name


class MetalIndex(NamedTuple):
    """Complex refractive index n + i k of a metal, and its source.

    Attributes:
        n: real part, no unit, shape of the wavelengths.
        k: extinction coefficient, no unit, shape of the wavelengths.
        source: citation of the table.
    """

    n: np.ndarray
    k: np.ndarray
    source: str


def metals(name: str | None = None) -> dict[str, tuple[str, ...]]:
    """List the tabulated metals with their tables.

    Published tables of one metal differ. The reflectance of chromium at 550 nm is 0.555, 0.650 or 0.681, depending on the
    table.

    Args:
        name: name of one metal, such as "Cr" or "brass". Default: None, all metals.

    Returns:
        Names of the tables of each metal, by the name of the metal. `metal` accepts the name of a table as `source`, and the
        name of a metal as `name`.

    Raises:
        ArgumentError: the metal is unknown. The message contains the nearest name, or all names.

    Source:
        refractiveindex.info database (Polyanskiy 2024), CC0; each table cites its measurement.

    Example:
        >>> len(matcam.material.metals("Cr")["Cr"])
        3
    """
    tables: dict[str, tuple[str, ...]] = {}
    for metal, source in _files():
        tables[metal] = (*tables.get(metal, ()), source)
    if name is None:
        return tables
    if name not in tables:
        raise unknown_name("metal", name, tables)
    return {name: tables[name]}


def metal(name: str, wavelength: ArrayLike, source: str | None = None) -> MetalIndex:
    """Interpolate the complex refractive index of a metal at given wavelengths.

    The interpolation in a published table is linear.

    Args:
        name: name of the metal, one of `material.metals()`, such as "Cr" or "brass".
        wavelength: wavelength in vacuum, m, any shape.
        source: name of the table, one of `material.metals(name)`. Default: None, the first table. Compare several
            tables, because published values of one metal differ.

    Returns:
        `MetalIndex` with n and k, no unit, shape of `wavelength`, and the citation.

    Raises:
        ArgumentError: the metal or the source is unknown, or a wavelength is not a number or lies outside the table.

    Source:
        refractiveindex.info database (Polyanskiy 2024), CC0.

    Example:
        >>> copper = matcam.metal("Cu", 650e-9)
        >>> bool(copper.k > 3)
        True
    """
    sources = metals(name).get(name, ())
    if not sources:
        raise unknown_name("metal", name, metals())
    source = sources[0] if source is None else source
    if not isinstance(source, str) or source not in sources:
        raise unknown_name(f"source for {name}", source, sources)
    tabulated, table = _table(name, source)
    wavelength = np.asarray(checks.numbers("wavelength", wavelength))
    low, high = tabulated[[0, -1]]
    outside = ~((wavelength >= low) & (wavelength <= high))
    if outside.any():
        raise ArgumentError(
            f"{name} ({source}) is tabulated from {low * 1e9:.0f} to {high * 1e9:.0f} nm, but is required at "
            f"{wavelength[outside].flat[0] * 1e9:g} nm: give wavelengths of this range, in m, such as 550e-9 for 550 nm"
        )
    return MetalIndex(
        np.interp(wavelength, tabulated, table.n), np.interp(wavelength, tabulated, table.k), table.source
    )


@cache
def _files() -> list[tuple[str, str]]:
    names = [entry.name for entry in resources.files("matcam").joinpath("data/metals").iterdir()]
    return sorted(tuple(name.split(".")[:2]) for name in names if name.endswith(".csv"))  # type: ignore[misc]


@cache
def _table(name: str, source: str) -> tuple[np.ndarray, MetalIndex]:
    text = resources.files("matcam").joinpath(f"data/metals/{name}.{source}.csv").read_text(encoding="utf-8")
    citation, *lines = text.splitlines()
    _, *rows = [line for line in lines if not line.startswith("#")]  # wavelength_um,n,k
    wavelength, n, k = np.loadtxt(rows, delimiter=",", unpack=True)
    return wavelength * 1e-6, MetalIndex(n, k, citation.removeprefix("# "))
