"""Optical constants of metals, from published tables (CC0, refractiveindex.info) that ship with the package."""

from __future__ import annotations

import csv
from functools import cache
from importlib import resources
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from matcam.core.errors import ArgumentError, unknown_name


class MetalIndex(NamedTuple):
    """Complex index n + i k of a metal, and where it comes from."""

    n: np.ndarray
    k: np.ndarray
    source: str


class _Table(NamedTuple):
    wavelength: np.ndarray  # m
    n: np.ndarray
    k: np.ndarray
    citation: str


def metals() -> list[str]:
    """Names of the metals that the package knows."""
    return sorted({metal for metal, _ in _files()})


def metal_sources(name: str) -> list[str]:
    """Names of the tables that the package carries for a metal. Where sources disagree, so do results: chromium's
    reflectance at 550 nm is 0.555, 0.650 or 0.681."""
    sources = [source for metal, source in _files() if metal == name]
    if not sources:
        raise unknown_name("metal", name, metals())
    return sources


def metal(name: str, wavelength: ArrayLike, source: str | None = None) -> MetalIndex:
    """Complex index of a metal at `wavelength` (m, any shape), linearly interpolated in a published table.

    source: one of `metal_sources(name)`; default the first. Raises ArgumentError for an unknown metal or source (with
    the nearest name), and outside the table.
    """
    sources = metal_sources(name)
    source = sources[0] if source is None else source
    if source not in sources:
        raise unknown_name(f"source for {name}", source, sources)
    table = _table(name, source)
    wavelength = np.asarray(wavelength, dtype=np.float64)
    low, high = table.wavelength[[0, -1]]
    outside = ~((wavelength >= low) & (wavelength <= high))
    if outside.any():
        raise ArgumentError(
            f"{name} ({source}) is tabulated from {low * 1e9:.0f} to {high * 1e9:.0f} nm, asked for at "
            f"{wavelength[outside].flat[0] * 1e9:g} nm (wavelengths are in m: 550 nm is 550e-9)"
        )
    return MetalIndex(
        np.interp(wavelength, table.wavelength, table.n),
        np.interp(wavelength, table.wavelength, table.k),
        table.citation,
    )


@cache
def _files() -> list[tuple[str, str]]:
    """(metal, source) of every table."""
    names = [entry.name for entry in resources.files("matcam").joinpath("data/metals").iterdir()]
    return sorted(tuple(name.split(".")[:2]) for name in names if name.endswith(".csv"))  # type: ignore[misc]


@cache
def _table(name: str, source: str) -> _Table:
    text = resources.files("matcam").joinpath(f"data/metals/{name}.{source}.csv").read_text(encoding="utf-8")
    lines = text.splitlines()
    comments = [line[2:] for line in lines if line.startswith("#")]
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    wavelength, n, k = (np.array([float(row[key]) for row in rows]) for key in ("wavelength_um", "n", "k"))
    return _Table(wavelength * 1e-6, n, k, comments[0])
