"""Tables of results in Markdown, the page with one figure a case, and the sentence of the README."""

import html
import io
from functools import partial

import numpy as np
from benchmarks.recovery import photographs, scoring, summary
from benchmarks.recovery.cases import PUBLIC
from benchmarks.recovery.run import OWN, describe

from matcam.figures.style import BLACK, CYCLE, GREY, ORANGE, VERMILION, styled

LINES = ("-", "--", ":", "-.")


def per_cent(value):
    """Share as text, with two digits."""
    if value is None or not np.isfinite(value):
        return "-"
    return f"{100 * value:.0f} %" if value >= 0.0995 else f"{100 * value:.2g} %"


def table(columns, rows):
    """Table as lines of Markdown."""
    return [
        f"| {' | '.join(columns)} |",
        "|" + "---|" * len(columns),
        *(f"| {' | '.join(str(cell) for cell in row)} |" for row in rows),
    ]


def rivals(scores):
    """Methods that are compared with the package: all that do not contain it."""
    return [method for method in scores if not method.startswith(OWN)]


def methods(scores):
    """What each method does."""
    return [f"- **{method}**. {describe(method)}" for method in scores]


def photograph_methods(scores):
    """What the package does with photographs."""
    return [f"- **{method}**. {describe(method, True)}" for method in scores if method.startswith(OWN)]


def errors(scores):
    """Median over the cases of the rms relative errors of all methods; the smallest without the package's is bold."""
    keys = [(q, b) for q in ("peak", "F", "slope", "tail") for b in scoring.BANDS]
    found = {method: summary.median_errors(of_cases) for method, of_cases in scores.items()}
    rows = []
    for quantity, band in keys:
        values = {m: found[m].get((quantity, band)) for m in scores}
        least = min((v for m, v in values.items() if v is not None and m != f"{OWN}, true lens"), default=None)
        cells = [f"**{per_cent(v)}**" if v is not None and v == least else per_cent(v) for v in values.values()]
        rows.append([quantity, band, *cells])
    return table(["quantity", "θ_d, degrees", *scores], rows)


def overview(scores):
    """Coverage, harm, support and cost of each method."""
    rows = []
    for method, of_cases in scores.items():
        covered = summary.coverage(of_cases)
        rows.append(
            [
                method,
                *(
                    f"{covered[kind]['within 1']:.0%}, {covered[kind]['within 2']:.0%}".replace("%", " %")
                    if kind in covered
                    else "-"
                    for kind in scoring.CLASSES
                ),
                f"{len(summary.harmed(of_cases))} of {len(of_cases)}",
                per_cent(summary.mean_of(of_cases, "supported peaks")),
                per_cent(summary.mean_of(of_cases, "false support")),
                _cost(summary.total(of_cases, "seconds"), "s"),
                _cost(summary.largest(of_cases, "memory_mib"), "MiB"),
            ]
        )
    return table(
        [
            "method", *(f"{kind}: within 1, 2 std" for kind in scoring.CLASSES), "harmed tables", "supported peaks",
            "false support", "time, all tables", "memory",
        ],
        rows,
    )  # fmt: skip


def verdict(scores, public=PUBLIC):
    """Required figures of the package, and measured ones. public: cases that must have a score."""
    found = summary.comparison(scores, OWN, rivals(scores))
    of_cases, covered = scores[OWN], summary.coverage(scores[OWN])
    rows = [
        ["public cases with a score of every method", str(len(public)), str(len(of_cases))],
        ["rows in which no baseline has a smaller error", "-", f"{found['best']} of {found['rows']}"],
        [
            "rows in which `matcam` is best, or within its stated error of the best",
            "≥ 95 %",
            f"{found['within']} of {found['rows']} ({found['within'] / found['rows']:.1%})".replace("%", " %"),
        ],
    ]
    for kind, part in covered.items():
        for name, (low, high) in summary.COVERED.items():
            asked = f"{low:.0%} to {high:.0%}" if high < 1 else f"≥ {low:.0%}"
            rows.append([f"coverage of {kind}s, {name} std", asked.replace("%", " %"), per_cent(part[name])])
    rows.append(["harmed tables", "0", f"{len(summary.harmed(of_cases))} of {len(of_cases)}"])
    lines = table(["quantity", "required", "measured"], rows)
    if len(of_cases) < len(public):
        missing = f"**Incomplete**: the result file holds {len(of_cases)} of {len(public)} cases."
        lines = [missing + " `make benchmark` computes the others; no figure below describes them.", "", *lines]
    return lines


def per_case(scores):
    """Errors of the package in each case, beside the best baseline: peaks, coverage, harm, support."""
    rows = []
    for case, score in scores[OWN].items():
        peaks = _mean_peak(score)
        others = {m: _mean_peak(scores[m][case]) for m in rivals(scores) if case in scores[m]}
        best = min(others, key=others.get)
        bad = summary.outside(score)
        rows.append(
            [
                f"`{case}`",
                per_cent(_mean_peak(scores["do nothing"][case])) if "do nothing" in scores else "-",
                f"{per_cent(others[best])} ({best})",
                f"**{per_cent(peaks)}**" if peaks <= others[best] else per_cent(peaks),
                per_cent(score["supported peaks"]),
                per_cent(score["false support"]),
                per_cent(score["harm"]),
                ", ".join(bad) or "-",
            ]
        )
    return table(
        [
            "case", "peaks as recorded", "best baseline", OWN, "supported peaks", "false support", "harmed entries",
            "coverage outside of the range",
        ],
        rows,
    )  # fmt: skip


def beaten(scores):
    """Rows in which a baseline has a smaller error than the package, largest difference first."""
    found = summary.comparison(scores, OWN, rivals(scores))["beaten"]
    found = sorted(found, key=lambda one: (one["within"], one["rival rms"] - one["rms"]))
    rows = [
        [
            f"`{one['case']}`",
            one["quantity"],
            one["theta_d"],
            per_cent(one["rms"]),
            per_cent(one["predicted"]),
            f"{per_cent(one['rival rms'])} ({one['rival']})",
            "yes" if one["within"] else "**no**",
        ]
        for one in found
    ]
    head = ["case", "quantity", "θ_d", OWN, "its stated error", "best baseline", "within the stated error"]
    return table(head, rows) if rows else ["No row."]


def readme(scores):
    """Sentences of the README on the benchmark. An incomplete result file gives no figures."""
    if len(scores[OWN]) < len(PUBLIC):
        return [
            "A [public benchmark](docs/validation/recovery.md) compares `matcam` with baselines on "
            f"{len(PUBLIC)} simulated tables of known truth."
        ]
    key = "peak", "60-80"
    found = summary.comparison(scores, OWN, rivals(scores))
    median = {method: summary.median_errors(of_cases)[key] for method, of_cases in scores.items()}
    best = min((m for m in rivals(scores) if m != "do nothing"), key=median.get)
    tables, harmed = len(scores[OWN]), len(summary.harmed(scores[OWN]))
    return [
        f"A [public benchmark](docs/validation/recovery.md) compares methods on {tables} simulated tables, whose lens "
        "is known to 3 %, to 30 % or not",
        f"at all. The median error of peaks at θ_d of 60° to 80° is {per_cent(median['do nothing'])} as recorded, "
        f"{per_cent(median[best])} by the best baseline ({best}), and",
        f"{per_cent(median[OWN])} by `matcam`. `matcam` is best, or within its stated error of the best, in "
        f"{found['within']} of {found['rows']} rows. It harms {harmed} of {tables} tables.",
    ]


def with_blocks(text, blocks):
    """Text in which the lines between the marks of each block are replaced."""
    for name, lines in blocks.items():
        before, mark, rest = text.partition(f"<!-- {name} -->\n")
        _, end, after = rest.partition(f"<!-- end of {name} -->\n")
        if not mark or not end:
            raise ValueError(f"the page has no marks of the block {name}")
        text = f"{before}{mark}" + "\n".join(lines) + f"\n{end}{after}"
    return text


def blocks(scores):
    """Blocks of the documentation page on tables."""
    parts = {
        "methods": methods, "verdict": verdict, "errors": errors, "overview": overview, "cases": per_case,
        "beaten": beaten,
    }  # fmt: skip
    return {name: make(scores) for name, make in parts.items()}


def photograph_blocks(scores):
    """Blocks of the documentation page on photographs."""
    parts = {
        "methods": photograph_methods, "verdict": partial(verdict, public=photographs.PUBLIC), "errors": errors,
        "overview": overview, "cases": per_case, "beaten": beaten,
    }  # fmt: skip
    return {
        f"{name} of photographs": make(scores) if scores.get(OWN) else ["No result."] for name, make in parts.items()
    }


def _mean_peak(score):
    """Quadratic mean over the bands of the rms errors of peaks."""
    return float(np.sqrt(np.mean([row["rms"] ** 2 for row in score["rows"] if row["quantity"] == "peak"])))


def _cost(value, unit):
    return "-" if value is None else f"{value:.0f} {unit}"


def figure(case, scores, facts):
    """Figure of a case: left the recovered over the true peak, right the rms errors by class and band, of all methods."""
    from matplotlib.figure import Figure

    with styled():
        drawn = Figure(figsize=(9.0, 3.4), layout="constrained")
        left, right = drawn.subplots(1, 2)
        ticks = None
        for n, (method, of_cases) in enumerate(scores.items()):
            if case not in of_cases:
                continue
            score = of_cases[case]
            colour = (
                VERMILION if method == OWN else (BLACK if method == "do nothing" else _others()[n % len(_others())])
            )
            style = {"color": colour, "linestyle": LINES[n // 4 % 4], "linewidth": 2.4 if method == OWN else 1.2}
            curve = [np.nan if v is None else v for v in score["peak curve"]]
            left.plot(np.arange(len(curve)) * 3 + 0.5, curve, label=method, **style)
            rows = {(row["quantity"], row["theta_d"]): row["rms"] for row in score["rows"]}
            ticks = ticks or list(rows)
            right.plot([rows.get(key, np.nan) for key in ticks], marker=".", **style)
        left.axhline(1, color=GREY, linewidth=0.6)
        left.set(xlabel="θ_d (degrees)", ylabel="recovered / true peak (1)", xlim=(0, 80), ylim=(0, 1.6))
        right.set(yscale="log", ylabel="rms relative error (1)", xticks=range(len(ticks)))
        right.set_xticklabels([f"{q}\n{b}°" for q, b in ticks], fontsize=6.5)
        drawn.suptitle(f"{case}: {facts}", fontsize=10)
        drawn.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=7.5)
    return drawn


def _others():
    return [c for c in CYCLE if c not in (VERMILION, BLACK)] + [ORANGE]


def svg(drawn):
    """Figure as SVG text."""
    out = io.StringIO()
    with styled():
        drawn.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    text = out.getvalue()
    return text[text.index("<svg") :]


def html_page(title, scores, facts):
    """Page with the tables and one figure a case. facts: {case: text}."""
    parts = [f"<h1>{html.escape(title)}</h1>"]
    for heading, make in (("Errors", errors), ("Coverage, harm, support, cost", overview)):
        parts += [f"<h2>{heading}</h2>", _html_table(make(scores))]
    for case in dict.fromkeys(case for of_cases in scores.values() for case in of_cases):
        parts += [f"<h2>{html.escape(case)}</h2>", svg(figure(case, scores, facts[case]))]
    style = (
        "body{font-family:sans-serif;max-width:70em;margin:auto}td,th{padding:.2em .6em;border-bottom:1px solid #ddd}"
    )
    head = f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{html.escape(title)}</title><style>{style}</style>'
    return head + "\n".join(parts) + "</html>\n"


def _html_table(lines):
    out = []
    for n, line in enumerate(lines):
        if n != 1:
            cell = "th" if n == 0 else "td"
            cells = [html.escape(text.strip().strip("*")) for text in line.strip("|").split("|")]
            out.append("<tr>" + "".join(f"<{cell}>{text}</{cell}>" for text in cells) + "</tr>")
    return "<table>" + "".join(out) + "</table>"
