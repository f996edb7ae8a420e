"""A table with truth that takes no quadrature: half of the light is lost at peaks."""

from functools import cache

import numpy as np
from benchmarks.recovery import cases, generate

from tests.oracle.merl_lobe import THETA_H
from tests.oracle.sphere_cells import GGX, Setup
from tests.oracle.whole_tables import Case, truth

CASE = cases.RecoveryCase(Case("synthetic", cases.metal(GGX(0.05), cases.CHROMIUM), Setup(), cases.KNOWN), "Gaussian")


@cache
def table():
    """Recorded without noise: 50 % of the value at the middle of the lobe, and all of it far away."""
    true = truth(CASE.table)
    lost = 0.5 * np.exp(-((THETA_H / 0.05) ** 2))
    clean = true * (1 - lost[:, None, None, None])
    return generate.Table(clean, clean, true, generate.judged_cells())
