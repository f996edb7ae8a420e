"""Commands of the benchmark, from the root of the checkout: PYTHONPATH=. python -m benchmarks.recovery COMMAND."""

import argparse
import importlib.util
import json
import os
import sys
from pathlib import Path

from benchmarks.recovery import baselines, cases, entries, generate, photographs

HERE = Path(__file__).resolve().parent
RESULTS = HERE / "results.json"
HASH = HERE / "hidden.sha256"
PAGE = generate.ROOT / "docs" / "validation" / "recovery.md"
PHOTOGRAPHS = PAGE.with_name("recovery-photographs.md")
"""Page of the results for photographs."""
CASES = PAGE.with_name("recovery-cases.md")
"""Page that defines cases, scores and methods."""
README = generate.ROOT / "README.md"
KINDS = ("tables", "photographs")


def main(arguments=None):
    """Run a command, and return its exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.recovery", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(name, call, text):
        one = commands.add_parser(name, help=text, description=text)
        one.set_defaults(call=call)
        one.add_argument("--seeds", type=Path, help="file with the seeds of hidden cases, instead of the public cases")
        one.add_argument("--cases", nargs="+", metavar="NAME", help="only these cases")
        one.add_argument("--kind", choices=KINDS, help="only cases of tables, or of photographs. Default: both")
        return one

    command("write", _write, "write the recorded tables and photographs, and what is stated of them").add_argument(
        "folder", type=Path
    )
    commands.choices["write"].add_argument("--truth", action="store_true", help="write the true tables, too")
    command("score", _score, "score an entry: a folder of tables").add_argument("folder", type=Path)
    commands.choices["score"].add_argument("-o", "--output", type=Path, default=Path("scores"), help="folder")
    one = command("run", _run, "run all baselines and the package")
    one.add_argument("--workers", type=int, default=2, help="processes. Default: 2")
    one.add_argument("--methods", nargs="+", metavar="NAME", help="only these methods")
    one = command("publish", _publish, "write results.json, the page and the README from the scores that exist")
    one.add_argument("--methods", nargs="+", metavar="NAME", help="only these methods")
    commands.add_parser("page", help="write the documentation page from results.json").set_defaults(call=_page)
    options = parser.parse_args(arguments)
    try:
        return options.call(options) or 0
    except entries.EntryError as error:
        print(error, file=sys.stderr)
        return 1


def chosen(options):
    """Cases that the options select. Raises EntryError where a name or a list of seeds is wrong."""
    found = [*cases.PUBLIC, *photographs.PUBLIC]
    if options.seeds:
        try:
            text = options.seeds.read_text(encoding="utf-8")
        except (OSError, ValueError):
            raise entries.EntryError(f"{options.seeds}: cannot be read as text") from None
        if cases.seeds_hash(text) != HASH.read_text(encoding="utf-8").split()[0]:
            raise entries.EntryError(
                f"{options.seeds}: its hash is not that of {HASH.name}: these are not the hidden seeds"
            )
        found = [draw(seed) for draw in (cases.hidden_case, photographs.hidden_case) for seed in text.split()]
    if options.kind:
        found = [case for case in found if photographs.is_photographs(case) == (options.kind == "photographs")]
    if options.cases:
        unknown = set(options.cases) - {case.name for case in found}
        if unknown:
            raise entries.EntryError(f"no case is named {', '.join(sorted(unknown))}")
        found = [case for case in found if case.name in options.cases]
    return found


def _write(options):
    import xarray as xr
    from benchmarks.recovery import run

    from matcam.io import write_netcdf

    options.folder.mkdir(parents=True, exist_ok=True)
    for case in chosen(options):
        table, given, facts = run.data(case, generate.FOLDER)
        parts = {".nc": _pictures(given) if photographs.is_photographs(case) else _table(given)}
        parts |= {".truth.nc": _table(table.true)} if options.truth else {}
        for suffix, variable in parts.items():
            write_netcdf(options.folder / f"{case.name}{suffix}", xr.Dataset({variable.name: variable}), force=True)
        run.write(options.folder / f"{case.name}.json", facts)
        print(case.name, flush=True)


def _table(values):
    import numpy as np

    from matcam.core.grid import brdf_table

    return brdf_table(values, "centre").astype(np.float64).rename("brdf")


def _pictures(values):
    import numpy as np
    import xarray as xr

    attributes = {"units": "1/sr", "long_name": "radiance per unit irradiance"}
    return xr.DataArray(
        values.astype(np.float32), dims=("lamp", "row", "column", "channel"), attrs=attributes, name="photograph"
    )


def _score(options):
    from benchmarks.recovery import page, run

    there = chosen(options)
    entry = entries.find(options.folder, [case.name for case in there])
    scores = {entry.name: run.entry_scores(entry, there, generate.FOLDER)}
    if not options.seeds and RESULTS.exists():
        kept = published()
        methods = dict.fromkeys(method for kind in KINDS for method in kept[kind] if method != entry.name)
        both = {m: {case: one for kind in KINDS for case, one in kept[kind].get(m, {}).items()} for m in methods}
        scores |= {m: {c: of_cases[c] for c in scores[entry.name] if c in of_cases} for m, of_cases in both.items()}
    run.write(options.output / "scores.json", scores)
    text = page.html_page(f"Recovery benchmark: {entry.name}", scores, facts(there))
    (options.output / "page.html").write_text(text, encoding="utf-8")
    print("\n".join([*page.errors(scores), "", *page.overview(scores)]))
    print(f"written: {options.output / 'scores.json'}, {options.output / 'page.html'}")


def _run(options):
    from benchmarks.recovery import page, run

    there, methods = chosen(options), chosen_methods(options)
    if set(methods) & set(baselines.RESTORED) and importlib.util.find_spec("skimage") is None:
        raise entries.EntryError(
            f"{' and '.join(baselines.RESTORED)} need scikit-image: pip install '.[benchmark]', or choose others by --methods"
        )
    scores = run.scores(there, methods, generate.FOLDER, options.workers, lambda line: print(line, flush=True))
    whole = not (options.seeds or options.cases or options.kind) and methods == run.METHODS
    run.write(generate.FOLDER / "scores.json", {"benchmark": 1, "scores": scores})
    text = page.html_page("Recovery benchmark", scores, facts(there))
    (generate.FOLDER / "page.html").write_text(text, encoding="utf-8")
    print(f"written: {generate.FOLDER / 'scores.json'}, {generate.FOLDER / 'page.html'}")
    if whole:
        _publish(options)


def chosen_methods(options):
    """Methods that the options select. Raises EntryError where a name is wrong."""
    from benchmarks.recovery import run

    unknown = set(options.methods or ()) - set(run.METHODS)
    if unknown:
        raise entries.EntryError(f"no method is named {', '.join(sorted(unknown))}; there are {', '.join(run.METHODS)}")
    return tuple(m for m in run.METHODS if m in (options.methods or run.METHODS))


def _publish(options):
    from benchmarks.recovery import run

    methods, found = chosen_methods(options), published()
    for kind, public in (("tables", cases.PUBLIC), ("photographs", photographs.PUBLIC)):
        scores = run.kept_scores(public, methods, generate.FOLDER)
        # without any complete case, the published scores of this kind stay
        if options.kind in (None, kind) and scores.get(run.OWN):
            found[kind] = scores
    if not found["tables"].get(run.OWN):
        raise entries.EntryError(f"{generate.FOLDER}: no case has a score of every method; run the methods first")
    run.write(RESULTS, {"benchmark": 1, "scores": found["tables"], "photographs": found["photographs"]})
    _page(options)
    print(f"written: {RESULTS}, {PAGE}, {README}")


def published():
    """Published scores {kind: {method: {case: score}}}."""
    document = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}
    return {"tables": document.get("scores", {}), "photographs": document.get("photographs", {})}


def _page(options):
    from benchmarks.recovery import page

    for path, blocks in generated().items():
        path.write_text(page.with_blocks(path.read_text(encoding="utf-8"), blocks), encoding="utf-8")


def generated():
    """Generated blocks {page: {name: lines}}, from the published scores."""
    from benchmarks.recovery import page

    kept = published()
    of_tables, of_photographs = page.blocks(kept["tables"]), page.photograph_blocks(kept["photographs"])
    methods = {
        name: of.pop(name) for of in (of_tables, of_photographs) for name in list(of) if name.startswith("methods")
    }
    of_readme = {"benchmark": page.readme(kept["tables"])}
    return {PAGE: of_tables, PHOTOGRAPHS: of_photographs, CASES: methods, README: of_readme}


def facts(there):
    """{case: lens, what is stated of it, and cells, as text}."""
    return {case.name: f"{case.lens} lens, {_knowledge(case)}, {_source(case)}" for case in there}


def _knowledge(case):
    return f"stated to {case.table.stated[1]:.0%}" if case.table.stated else "not stated"


def _source(case):
    return "photographs" if photographs.is_photographs(case) else f"cells: {case.rule}"


if __name__ == "__main__":
    os.environ.setdefault("XDG_CACHE_HOME", str(generate.FOLDER / "cache"))
    sys.exit(main())
