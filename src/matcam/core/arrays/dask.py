"""Dask, which this package requires only for a cluster.

xarray imports Dask, if it is installed, to check the types of arrays. The import takes half a second.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def without_dask() -> Iterator[None]:
    """Hide Dask from imports, unless it is already imported or `show_dask` is called."""
    sys.modules.setdefault("dask", None)  # type: ignore[arg-type]
    try:
        yield
    finally:
        show_dask()


def show_dask() -> None:
    """Allow imports of Dask."""
    if sys.modules.get("dask", sys) is None:
        del sys.modules["dask"]
