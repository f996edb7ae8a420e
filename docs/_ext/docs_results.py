"""Pages of the section Validation: tables of measured values, generated from the files in benchmarks/results."""

import json
import sys
from pathlib import Path

import docs_api

ROOT = Path(__file__).resolve().parents[2]
ACCURACY = ROOT / "benchmarks" / "results" / "accuracy"
sys.path.insert(0, str(ROOT / "benchmarks"))

import results  # noqa: E402


def pages():
    """Return the names of the generated pages."""
    return [*sorted(path.stem for path in ACCURACY.glob("*.json")), "benchmarks"]


def write(folder):
    """Write all pages into a folder; other pages of the folder are written by hand."""
    for path in sorted(ACCURACY.glob("*.json")):
        docs_api.update(folder / f"{path.stem}.md", page(json.loads(path.read_text(encoding="utf-8"))))
    text = results.page().replace("# Benchmark results", "# Speed and memory")
    docs_api.update(folder / "benchmarks.md", text)


def page(document):
    """Convert a file of measured values to Markdown."""
    lines = [f"# {document['title']}", "", document["intro"], ""]
    for one in document["tables"]:
        lines += [f"## {one['title']}", "", *table(one["columns"], one["rows"]), ""]
        if "note" in one:
            lines += [one["note"], ""]
    if document["limitations"]:
        lines += ["## Limitations", "", *(f"- {one}" for one in document["limitations"]), ""]
    return "\n".join(lines)


def table(columns, rows):
    """Convert a table to lines of Markdown."""
    shown = [[cell.replace("|", "\\|") for cell in row] for row in (columns, *rows)]
    lines = [f"| {' | '.join(row)} |" for row in shown]
    return [lines[0], "|" + "---|" * len(columns), *lines[1:]]
