"""The figures of corrections of drawn tables, by class, from the lines of `drawn_corrections`."""

import numpy as np

from tests.oracle.drawn_tables import KINDS

SURE = 3.0
"""Standard deviations beyond which support is false."""


def flat(lines):
    """Columns over all judged entries of all lines, and of each the number of its line."""
    rows = [np.array(one["entries"]).reshape(-1, 9) for one in lines]
    columns = np.concatenate(rows).T
    names = ("kind", "slice", "true", "clean", "raw", "value", "std", "camera", "supported")
    out = dict(zip(names, columns, strict=True))
    out["line"] = np.repeat(np.arange(len(lines)), [len(row) for row in rows])
    out["supported"] = out["supported"] > 0
    for name in ("known",):
        out[name] = np.array([one[name] for one in lines])[out["line"]]
    out["bound"] = np.concatenate([_bounds(one, row[:, 1]) for one, row in zip(lines, rows, strict=True)])
    return out


def _bounds(line, slices):
    if not line["bound"]:
        return np.full(slices.size, np.nan)
    theta_d, std = np.array(line["bound"]).T
    return np.interp(slices + 0.5, theta_d, std, right=np.nan)


def harmed(e):
    """Entries that are further from the truth than what was recorded, by more than 2 standard deviations and 1 %."""
    return np.abs(e["value"] - e["true"]) > np.abs(e["raw"] - e["true"]) + 2 * e["std"] + 0.01 * e["true"]


def _rms(values):
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else float("nan")


def _share(values):
    return float(np.mean(values)) if values.size else float("nan")


def figures(lines):
    """What all draws together say."""
    done = [one for one in lines if "entries" in one]
    e = flat(done)
    pull = np.abs(e["value"] - e["true"]) / e["std"]
    stated = np.isfinite(e["std"])
    coverage = {}
    for number, kind in enumerate(KINDS):
        for name, chosen in (("supported", e["supported"]), ("not supported", ~e["supported"])):
            here = (e["kind"] == number) & chosen & stated
            coverage[f"{kind}, {name}"] = {
                "entries": int(here.sum()), "within 1": _share(pull[here] < 1), "within 2": _share(pull[here] < 2),
                "rms pull": _rms(pull[here]),
            }  # fmt: skip
    # what was recorded below 0 is corrected to 0
    bar = relative_bar(e)
    peak = e["kind"] == 0
    supported_peak = peak & e["supported"] & np.isfinite(e["bound"]) & stated
    kept = e["clean"] / e["true"]
    before, after = (np.abs(e[name] / e["true"] - 1) for name in ("raw", "value"))
    lost = e["supported"] & (kept < 0.8)
    f75 = np.array([one["f75"] for one in done])
    f75 = f75[np.isfinite(f75).all(1)] if f75.size else np.zeros((0, 2))
    return {
        "draws": len(lines), "failed": len(lines) - len(done), "coverage": coverage,
        "bar over bound of supported peaks": _share((bar / e["bound"])[supported_peak]),
        "peaks supported where 20 % is kept": {
            f"{known:.0%}": _share(e["supported"][peak & (kept >= 0.2) & (e["known"] == known)]) for known in (0.03, 0.3)
        },
        "rms before": _rms(before[lost]), "rms after": _rms(after[lost]),
        "false support": _share(pull[e["supported"]] > SURE), "harmed": int(harmed(e)[stated].sum()),
        "entries": int(stated.sum()), "F(75) rms": _rms(f75[:, 0]), "F(75) pulls": _rms(f75[:, 0] / f75[:, 1]),
        "F(75) within 1": _share(np.abs(f75[:, 0]) < f75[:, 1]),
    }  # fmt: skip


def relative_bar(e):
    """The standard deviation over the value; infinite where a value was corrected to 0."""
    return np.divide(e["std"], e["value"], out=np.full_like(e["std"], np.inf), where=e["value"] > 0)


def worst(lines):
    """A row for each draw: what is false or harmed, pulls by kind, supported peaks, F(75)."""
    rows = []
    for one in lines:
        if "entries" not in one:
            rows.append(f"{one['number']:4} {one['family']:8} failed: {one['error']}")
            continue
        e = flat([one])
        pull = np.abs(e["value"] - e["true"]) / e["std"]
        pulls = [_rms(pull[(e["kind"] == n) & np.isfinite(pull)]) for n in range(3)]
        peak = e["kind"] == 0
        rows.append(
            f"{one['number']:4} {one['family']:8} {one['lens']:8} {one['known']:4.2f} {one['sigma']:.3f} {one['rule']:8} "
            f"kept {np.median((e['clean'] / e['true'])[peak]):.2f} supported {_share(e['supported'][peak]):.2f} "
            f"false {int((pull[e['supported']] > SURE).sum()):3} harmed {int(harmed(e)[np.isfinite(e['std'])].sum()):3} "
            f"pulls {pulls[0]:.2f} {pulls[1]:.2f} {pulls[2]:.2f} peak error "
            f"{np.median((e['value'] / e['true'] - 1)[peak]):+.3f} bar {np.median(relative_bar(e)[peak]):.3f} "
            f"F75 {one['f75'][0]:+.4f} +- {one['f75'][1]:.4f} "
            f"{one['fitted']} {one['determination']} {one['remarks']} {one['lobe']}"
        )
    return rows


def shown(found):
    """The figures as lines of text."""
    lines = [
        f"{name}: {part:.4g}" if isinstance(part, float) else f"{name}: {part}"
        for name, part in found.items()
        if name != "coverage"
    ]
    for name, part in found["coverage"].items():
        held = f"{part['within 1']:.1%} within 1, {part['within 2']:.1%} within 2"
        lines.append(f"{name}: {held}, rms pull {part['rms pull']:.2f} of {part['entries']}")
    return "\n".join(lines)
