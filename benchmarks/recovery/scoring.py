"""Scores of one recovered table against its truth.

Classes of entries: peak, slope and tail, by the true value over that at the middle of the lobe. Bands: ranges of theta_d.
"""

import numpy as np
from tests.oracle.merl_lobe import THETA_D

CLASSES = {"peak": (0.5, np.inf), "slope": (0.01, 0.5), "tail": (0.0, 0.01)}
"""Share of the value at the middle of the lobe, in the same slice and channel: above, up to."""
BANDS = {"0-30": (0, 30), "30-60": (30, 60), "60-80": (60, 80)}
"""Ranges of theta_d, degrees."""
DARKEST = 1e-9
"""True value, 1/sr, below which an entry is not judged: relative errors mean nothing there."""
MEASURABLE = 3.0
"""True value and clean record over the floor noise of a pixel, above which an error counts in a row: no method can determine
less."""
FEWEST = 100
"""Entries below which a row is left out."""
FALSE = 3.0
"""Standard deviations beyond which a supported entry is falsely supported."""
KEPT = 0.2
"""Share of a peak in the clean record from which support is required."""
SUPPORTED = 0.05
"""Relative standard deviation below which an entry counts as supported, where the entrant does not state support."""
HARMFUL = 1e-3
"""Share of harmed entries from which a table counts as harmed."""
NORMAL = (np.radians(10) < THETA_D) & (np.radians(45) > THETA_D)
"""Slices in which the curve of F has the mean 1."""


def score(table, value, std=None, supported=None, floor=0.0):
    """Scores of a recovered table, as plain data.

    value, std: (90, 90, 180, 3), 1/sr; a value that is missing counts as the recorded one. std: standard deviation of value;
    None or NaN: not stated. supported: None: derived from std. floor: noise of a pixel over the largest value of its slice.
    """
    answered = np.isfinite(value)
    value = np.where(answered, value, table.recorded).astype(float)
    std = np.full(value.shape, np.nan) if std is None else np.where(answered, std, np.nan).astype(float)
    if supported is None:
        with np.errstate(invalid="ignore"):
            supported = std < SUPPORTED * value
    true, judged = table.true, table.judged[..., None] & np.isfinite(table.recorded) & (table.true > DARKEST)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        share = true / np.nanmax(true[:1], axis=2, keepdims=True)
        relative, predicted = value / true - 1, std / true
        pull = np.abs(value - true) / std
        noise = floor * np.nan_to_num(table.clean).max(axis=(0, 2), keepdims=True)
        signal = np.minimum(table.clean, true) > MEASURABLE * noise
        harmed = np.abs(value - true) > np.abs(table.recorded - true) + 2 * np.nan_to_num(std) + 0.01 * true
    rows, coverage = [], {}
    for kind, (low, high) in CLASSES.items():
        of_class = judged & (share > low) & (share <= high)
        stated = of_class & np.isfinite(std) & (std > 0)
        if stated.sum() >= FEWEST:
            p = pull[stated]
            coverage[kind] = {"entries": int(p.size), "within 1": _share(p < 1), "within 2": _share(p < 2)}
        for band, inside in _bands():
            here = (of_class & signal)[:, inside]
            if here.sum() >= FEWEST:
                rows.append(_row(kind, band, relative[:, inside][here], predicted[:, inside][here]))
    rows += _fresnel_rows(table, value, std)
    kept = judged & (share > CLASSES["peak"][0]) & (table.clean >= KEPT * true)
    chosen = judged & supported
    return {
        "rows": rows,
        "coverage": coverage,
        "answered": _share(answered[judged]),
        "harm": _share(harmed[judged]),
        "supported peaks": _share(supported[kept]) if kept.any() and np.isfinite(std).any() else None,
        "false support": _share(pull[chosen] > FALSE) if chosen.any() else None,
        "peak curve": [float(f"{v:.5g}") for v in _peak_ratio(table, value)[::3, 1]],
    }


def _bands():
    degrees = np.degrees(THETA_D)
    for band, (low, high) in BANDS.items():
        yield band, (degrees >= low) & (degrees < high)


def _row(kind, band, error, predicted):
    """Row of relative errors. A stated relative standard deviation counts as 1 at most: such a value is not known."""
    stated = np.minimum(predicted[np.isfinite(predicted)], 1.0)
    return {
        "quantity": kind,
        "theta_d": band,
        "entries": int(error.size),
        "rms": _rms(error),
        "median": float(np.median(np.abs(error))),
        "predicted": _rms(stated) if stated.size else None,
    }


def _peaks(values):
    """Mean over phi_d of the innermost ring, (90, 3); NaN where all is missing."""
    there = np.isfinite(values[0])
    with np.errstate(invalid="ignore"):
        return np.where(there, values[0], 0).sum(1) / there.sum(1)


def _peak_ratio(table, value):
    """Recovered over true peak, (90, 3); NaN in slices whose peak is not recorded at all."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(np.isfinite(table.recorded[0]).any(1), _peaks(value) / _peaks(table.true), np.nan)


def _fresnel_rows(table, value, std):
    """Errors of the curve of F (13), read off the peaks: true masking and geometry cancel in the ratio to the truth."""
    rows, usable = [], np.isfinite(std[0]).any()
    ratio = _peak_ratio(table, value)
    with np.errstate(invalid="ignore", divide="ignore"):
        predicted = _peaks(std) / _peaks(table.true) if usable else np.full(ratio.shape, np.nan)
    ratio /= ratio[NORMAL].mean(0)
    for band, inside in _bands():
        here = np.isfinite(ratio) & inside[:, None]
        rows.append(_row("F", band, ratio[here] - 1, predicted[here]))
    return rows


def _rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def _share(values):
    return float(np.mean(values)) if np.size(values) else 0.0
