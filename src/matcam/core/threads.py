"""Threads of the libraries beneath NumPy, which read their number from the environment as they are loaded."""

from __future__ import annotations

import os
import sys

ONE_BLAS_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
"""Variables that keep linear algebra to the thread that asks for it.

Matrices of a fit have some thousand rows and twenty columns. OpenBLAS shares even those among all processors, and a thread that
waits for its share spins: on two busy processors a triangle of 5,000 rows takes 12 ms instead of 0.3 ms.
"""


def use_one_blas_thread() -> None:
    """Keep this process's linear algebra to one thread, unless the user says otherwise or NumPy is loaded already.

    A program may choose this for its user; a library must not.
    """
    if "numpy" not in sys.modules:
        for name, value in ONE_BLAS_THREAD.items():
            os.environ.setdefault(name, value)
