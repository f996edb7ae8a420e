"""Comparison of methods over all cases, from their scores."""

import numpy as np
from benchmarks.recovery import scoring

QUANTITIES = (*scoring.CLASSES, "F")
COVERED = {"within 1": (0.6, 0.8), "within 2": (0.93, 1.0)}
"""Required shares of entries within 1 and 2 stated standard deviations (68 % and 95 % of normal errors), in every class."""
TIE = 1e-6
"""Relative difference of two errors below which they are equal: results are reproducible to this."""


def by_row(scores):
    """Rows {(case, quantity, theta_d): {method: row}} of all methods."""
    found = {}
    for method, of_cases in scores.items():
        for case, score in of_cases.items():
            for row in score["rows"]:
                found.setdefault((case, row["quantity"], row["theta_d"]), {})[method] = row
    return found


def comparison(scores, own, rivals):
    """Rows of a method against the best of its rivals.

    "best" counts rows in which no rival has a smaller rms error. "within" counts those and the rows in which the error exceeds
    that of the best rival by at most the rms of the stated relative standard deviations. "beaten" lists all rows that are not
    best.
    """
    best, within, beaten = 0, 0, []
    rows = {key: row for key, row in by_row(scores).items() if own in row}
    for (case, quantity, band), of_methods in rows.items():
        mine = of_methods[own]
        others = {m: of_methods[m]["rms"] for m in rivals if m in of_methods}
        rival = min(others, key=others.get)
        excess = mine["rms"] - others[rival]
        covered = excess <= TIE * mine["rms"] or (mine["predicted"] is not None and excess <= mine["predicted"])
        within += covered
        if excess <= TIE * mine["rms"]:
            best += 1
            continue
        beaten.append(
            {
                "case": case,
                "quantity": quantity,
                "theta_d": band,
                "rms": mine["rms"],
                "predicted": mine["predicted"],
                "rival": rival,
                "rival rms": others[rival],
                "within": covered,
            }
        )
    return {"rows": len(rows), "best": best, "within": within, "beaten": beaten}


def median_errors(of_cases):
    """Median over cases of the rms errors {(quantity, theta_d): error} of one method."""
    found = {}
    for score in of_cases.values():
        for row in score["rows"]:
            found.setdefault((row["quantity"], row["theta_d"]), []).append(row["rms"])
    return {key: float(np.median(values)) for key, values in found.items()}


def coverage(of_cases):
    """Mean coverage over tables, {class: {"within 1", "within 2", "tables"}}. A class without stated errors is left out."""
    found = {}
    for kind in scoring.CLASSES:
        parts = [score["coverage"][kind] for score in of_cases.values() if kind in score["coverage"]]
        if parts:
            found[kind] = {name: float(np.mean([part[name] for part in parts])) for name in COVERED}
            found[kind]["tables"] = len(parts)
    return found


def outside(score):
    """Classes of one table whose coverage is outside of the required ranges."""
    return [
        kind
        for kind, part in score["coverage"].items()
        if any(not low <= part[name] <= high for name, (low, high) in COVERED.items())
    ]


def harmed(of_cases):
    """Names of harmed tables."""
    return [case for case, score in of_cases.items() if score["harm"] >= scoring.HARMFUL]


def mean_of(of_cases, key):
    """Mean over tables of a figure that some tables lack; None where all lack it."""
    values = [score[key] for score in of_cases.values() if score.get(key) is not None]
    return float(np.mean(values)) if values else None


def total(of_cases, key):
    """Sum over tables of a cost; None where it is not stated."""
    values = [score[key] for score in of_cases.values() if score.get(key) is not None]
    return float(np.sum(values)) if values else None


def largest(of_cases, key):
    """Largest cost of a table; None where it is not stated."""
    values = [score[key] for score in of_cases.values() if score.get(key) is not None]
    return float(np.max(values)) if values else None
