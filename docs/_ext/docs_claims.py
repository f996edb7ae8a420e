"""Claims of `docs/claims.toml`, which a page lists and tests check."""

import tomllib
from functools import cache
from pathlib import Path

import docs_api

ROOT = Path(__file__).resolve().parents[2]


@cache
def claims():
    """Return {id: claim}, in the order of the file."""
    listed = tomllib.loads((ROOT / "docs" / "claims.toml").read_text(encoding="utf-8"))["claim"]
    return {one["id"]: one for one in listed}


def limit(name):
    """Return the limit of a claim: the largest value, or (low, high)."""
    found = claims()[name]["limit"]
    return tuple(found) if isinstance(found, list) else found


def table(link):
    """Build the table of all claims as lines of Markdown.

    link: function that returns the reference to the test of a claim.
    """
    lines = ["| claim | required | measured | test |", "|---|---|---|---|"]
    for one in claims().values():
        asked = f"≤ {one['limit']:g}" if not isinstance(one["limit"], list) else "{:g} to {:g}".format(*one["limit"])
        asked = asked.replace("e-0", "e-")
        lines.append(f"| {one['claim']} | {asked} | {one['measured']} | {link(one)} |")
    return lines


def shown_on_page(one):
    """Return the test of a claim and the page of its method."""
    if "benchmark" in one:
        return "`benchmarks/RESULTS.md`"
    path, _, name = one["test"].partition("::")
    more = f", [method](/{one['page']})" if "page" in one else ""
    return f"`{path}`, `{name}`{more}"


def taken(docs):
    """Return the sentence on the tables that the inverse commands accept.

    docs: address of the folder of pages.
    """
    return (
        "`fit`, `fresnel` and `correct` take tables of a sphere or a cylinder, with camera and lamp near or distant "
        f"([what is supported]({docs}/reference/supported.md)). A table of a flat sample is not blurred."
    )


def write(path):
    """Write the page of claims."""
    text = "\n".join(
        [
            "# Can I trust it?",
            "",
            "Each claim of this table is an entry of `docs/claims.toml`. The test beside a claim reads its limit from that file, so "
            "that page, limit and test agree. [Validation](/validation/index.md) has all measured figures, and the cases that fall short.",
            "",
            *table(shown_on_page),
            "",
            "**Supported tables.** " + taken(""),
            "",
            "**Truth.** The tests compare with `tests/oracle`, which imports nothing of the package, with golden values, and with other "
            "libraries. An inverse is never tested with data from its own forward model alone.",
            "",
            "**Errors.** Every result has a standard deviation. Simulations with known truth check it: the claims on coverage above.",
            "",
            "**Refusals.** Where rig and data contradict each other, the correction is withheld ([limits](limits.md)).",
            "",
        ]
    )
    docs_api.update(path, text)
