"""Which material of a run stands in which row of its Zarr."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from matcam.batch.job import Job
from matcam.batch.store import open_rows, whole_rows, write_row
from matcam.files.netcdf import read_netcdf

STORE = "run.zarr"


def with_rows(store: Path, jobs: Sequence[Job], waiting: Sequence[Job]) -> list[Job]:
    """The jobs that are waiting, each told its row. Rows of finished materials that are not whole, because the Zarr was asked
    for later, or lost, are copied from their NetCDF. Errors as `open_rows`'s and `write_row`'s."""
    if not jobs:
        return list(waiting)
    rows = open_rows(store, [job.name for job in jobs], jobs[0].sampling)
    whole = whole_rows(store)
    later = {job.name for job in waiting}
    for job in jobs:
        if job.name not in later and not whole[rows[job.name]]:
            write_row(store, rows[job.name], read_netcdf(job.output.with_suffix(".nc")))
    return [replace(job, store=store, row=rows[job.name]) for job in waiting]
