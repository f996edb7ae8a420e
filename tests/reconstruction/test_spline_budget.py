"""Error budget of a spline-modified lobe that the pictures do not distinguish from the lens."""

from types import SimpleNamespace

import numpy as np

from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.inverse.fit.lobe_readings import half_maximum
from matcam.material.ndf.free_lobe import KNOTS
from matcam.reconstruction.error_budget import inseparable
from matcam.reconstruction.joint.field_change import FIELD

KIND = LobeKind("ggx", "smith", spline_size=KNOTS)
LENS = KIND.size  # the first of the scene


def test_a_modified_lobe_that_the_lens_mimics_is_named_by_its_half_width():
    """The pictures know half width times lens; the lens alone is stated."""
    q = np.r_[np.log(0.02), np.zeros(KNOTS)]
    size = KIND.size + 4 + 1 + len(FIELD)
    width, by_q = half_maximum(KIND, q)
    row = np.zeros(size)
    row[: KIND.size], row[LENS] = by_q / width, 1.0
    stated = np.zeros((size, size))
    stated[LENS, LENS] = 1 / 0.03**2
    # along all else than that sum, and of the half width the lens only, much is known
    others = 1e8 * (np.eye(size) - np.outer(row, row) / (row @ row))
    free = np.zeros(size)
    free[: KIND.size], free[LENS] = row[: KIND.size], -row[: KIND.size] @ row[: KIND.size]
    others -= 0.999999999 * 1e8 * np.outer(free, free) / (free @ free)
    covariance = np.linalg.inv(others + 1e8 * np.outer(row, row) + stated)
    solution = SimpleNamespace(
        p=np.r_[q, np.zeros(size - q.size)],
        fitted=covariance,
        problem=SimpleNamespace(information_of=lambda source: stated if source == "lens" else np.zeros_like(stated)),
        covariance_without=lambda change: np.linalg.inv(np.linalg.inv(covariance) - change),
    )
    pairs = inseparable(SimpleNamespace(kind=KIND, solution=solution, channels=("G",)))
    print(pairs)
    assert ("lens", "hwhm_rad") in [pair.names for pair in pairs]
    assert not any(name.startswith(("spline", "alpha")) for pair in pairs for name in pair.names)
