"""The claims of `docs/claims.toml`: printed in README and on a page, and read by the tests that show them."""

import tomllib
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


@cache
def claims():
    """Return {id: claim}, in the order of the file."""
    listed = tomllib.loads((ROOT / "docs" / "claims.toml").read_text(encoding="utf-8"))["claim"]
    return {one["id"]: one for one in listed}


def limit(name):
    """Return what a claim's test demands: a largest value, or (low, high)."""
    found = claims()[name]["limit"]
    return tuple(found) if isinstance(found, list) else found


def table(link):
    """Return the table of all claims as Markdown; link(claim) writes where a claim is shown."""
    lines = ["| claim | asked | measured | shown by |", "|---|---|---|---|"]
    for one in claims().values():
        asked = f"≤ {one['limit']:g}" if not isinstance(one["limit"], list) else "{:g} to {:g}".format(*one["limit"])
        lines.append(f"| {one['claim']} | {asked} | {one['measured']} | {link(one)} |")
    return lines


def shown_on_page(one):
    """Return a claim's test, and the page that says more, for the page of claims."""
    if "benchmark" in one:
        return "`benchmarks/RESULTS.md`"
    path, _, name = one["test"].partition("::")
    more = f", [more](/{one['page']})" if "page" in one else ""
    return f"`{path}`, `{name}`{more}"


def taken(docs):
    """Return the sentence on tables that the inverse commands take. docs: address of the folder of pages."""
    return (
        "**Which tables it takes**: `fit`, `fresnel` and `correct` take tables of a sphere or a cylinder, with camera and lamp near or "
        f"distant ([what takes what]({docs}/forward.md#what-takes-what)). A table of a flat sample is not blurred."
    )


def write(path):
    """Write the page."""
    text = "\n".join(
        [
            "# How good is it?",
            "",
            "Every claim stands once, in `docs/claims.toml`. The test beside it reads what it demands from that file.",
            "Claims with more cases, and what falls short, stand on the pages of each method.",
            "",
            *table(shown_on_page),
            "",
            taken(""),
            "",
        ]
    )
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def shown_in_readme(one):
    """Return where a claim is shown, for README."""
    if "benchmark" in one:
        return "[benchmarks](benchmarks/RESULTS.md)"
    path = one["test"].partition("::")[0]
    return f"[{Path(path).stem}]({path})" + (f", [more](docs/{one['page']})" if "page" in one else "")
