"""Results of benchmarks: one JSON file for each script in benchmarks/results, and the table of all in benchmarks/RESULTS.md.

A benchmark calls `record`; `python benchmarks/results.py` writes the table.
"""

import json
import os
import platform
from datetime import date
from importlib import metadata
from pathlib import Path

FOLDER = Path(__file__).resolve().parent / "results"
PAGE = FOLDER.parent / "RESULTS.md"


def machine() -> str:
    """Describe this machine: processor cores, memory, system and versions."""
    pages = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**30
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in ("jax", "numpy"))
    return (
        f"{os.cpu_count()} cores, {pages:.0f} GiB, {platform.system()}, Python {platform.python_version()}, {versions}"
    )


def record(script: str, rows: list[tuple[str, str, str]]) -> None:
    """Write the results of a script; earlier rows of other quantities stay, with their machine and date.

    script: name of the file, such as "bench_edge.py". rows: (quantity, required, measured), each a text.
    """
    FOLDER.mkdir(exist_ok=True)
    path = FOLDER / f"{Path(script).stem}.json"
    earlier = json.loads(path.read_text(encoding="utf-8"))["rows"] if path.exists() else []
    measured_now = {quantity for quantity, _, _ in rows}
    kept = [row for row in earlier if row["quantity"] not in measured_now]
    listed = kept + [
        {
            "quantity": quantity,
            "required": required,
            "measured": measured,
            "machine": machine(),
            "date": str(date.today()),
        }
        for quantity, required, measured in rows
    ]
    text = json.dumps({"script": script, "rows": listed}, indent=1, ensure_ascii=False)
    path.write_text(text + "\n", encoding="utf-8")


def page() -> str:
    """Return the table of all results as Markdown."""
    documents = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(FOLDER.glob("*.json"))]
    machines = list(dict.fromkeys(row["machine"] for document in documents for row in document["rows"]))
    lines = [
        "# Benchmark results",
        "",
        "`make bench` measures these values, writes them to `benchmarks/results`, and generates this table from those files. "
        "Both values of a ratio come from one run. Requirements that are not met are marked.",
        "",
        *(f"- Machine {number}: {words}." for number, words in enumerate(machines, 1)),
        "",
        "| script | quantity | required | measured | machine | date |",
        "|---|---|---|---|---|---|",
    ]
    for document in documents:
        for row in document["rows"]:
            cells = [f"`{document['script']}`", row["quantity"], row["required"], row["measured"]]
            cells += [str(1 + machines.index(row["machine"])), row["date"]]
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join([*lines, ""])


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
