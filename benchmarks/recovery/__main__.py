"""Commands of the benchmark, from the root of the checkout: PYTHONPATH=. python -m benchmarks.recovery COMMAND."""

import argparse
import importlib.util
import json
import os
import sys
from pathlib import Path

from benchmarks.recovery import cases, entries, generate

HERE = Path(__file__).resolve().parent
RESULTS = HERE / "results.json"
HASH = HERE / "hidden.sha256"
PAGE = generate.ROOT / "docs" / "validation" / "recovery.md"
README = generate.ROOT / "README.md"


def main(arguments=None):
    """Run a command, and return its exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.recovery", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(name, call, text):
        one = commands.add_parser(name, help=text, description=text)
        one.set_defaults(call=call)
        one.add_argument("--seeds", type=Path, help="file with the seeds of hidden cases, instead of the public cases")
        one.add_argument("--cases", nargs="+", metavar="NAME", help="only these cases")
        return one

    command("write", _write, "write the recorded tables and what is stated of them").add_argument("folder", type=Path)
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
    found = list(cases.PUBLIC)
    if options.seeds:
        try:
            text = options.seeds.read_text(encoding="utf-8")
        except (OSError, ValueError):
            raise entries.EntryError(f"{options.seeds}: cannot be read as text") from None
        if cases.seeds_hash(text) != HASH.read_text(encoding="utf-8").split()[0]:
            raise entries.EntryError(
                f"{options.seeds}: its hash is not that of {HASH.name}: these are not the hidden seeds"
            )
        found = [cases.hidden_case(seed) for seed in text.split()]
    if options.cases:
        unknown = set(options.cases) - {case.name for case in found}
        if unknown:
            raise entries.EntryError(f"no case is named {', '.join(sorted(unknown))}")
        found = [case for case in found if case.name in options.cases]
    return found


def _write(options):
    import numpy as np
    import xarray as xr
    from benchmarks.recovery.run import write

    from matcam.core.grid import brdf_table
    from matcam.io import write_netcdf

    options.folder.mkdir(parents=True, exist_ok=True)
    for case in chosen(options):
        table = generate.table(case)
        parts = {".nc": table.recorded} | ({".truth.nc": table.true} if options.truth else {})
        for suffix, values in parts.items():
            brdf = brdf_table(values, "centre").astype(np.float64)
            write_netcdf(options.folder / f"{case.name}{suffix}", xr.Dataset({"brdf": brdf}), force=True)
        write(options.folder / f"{case.name}.json", cases.stated(case))
        print(case.name, flush=True)


def _score(options):
    from benchmarks.recovery import page, run

    there = chosen(options)
    entry = entries.find(options.folder, [case.name for case in there])
    scores = {entry.name: run.entry_scores(entry, there, generate.FOLDER)}
    if not options.seeds and RESULTS.exists():
        kept = json.loads(RESULTS.read_text(encoding="utf-8"))["scores"]
        scores |= {m: {c: kept[m][c] for c in scores[entry.name]} for m in kept if m != entry.name}
    run.write(options.output / "scores.json", scores)
    text = page.html_page(f"Recovery benchmark: {entry.name}", scores, facts(there))
    (options.output / "page.html").write_text(text, encoding="utf-8")
    print("\n".join([*page.errors(scores), "", *page.overview(scores)]))
    print(f"written: {options.output / 'scores.json'}, {options.output / 'page.html'}")


def _run(options):
    from benchmarks.recovery import page, run

    there, methods = chosen(options), chosen_methods(options)
    if set(methods) & set(run.PHOTOGRAPHS) and importlib.util.find_spec("skimage") is None:
        raise entries.EntryError(
            f"{' and '.join(run.PHOTOGRAPHS)} need scikit-image: pip install '.[benchmark]', or choose others by --methods"
        )
    scores = run.scores(there, methods, generate.FOLDER, options.workers, lambda line: print(line, flush=True))
    whole = not options.seeds and len(there) == len(cases.PUBLIC) and methods == run.METHODS
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

    scores = run.kept_scores(cases.PUBLIC, chosen_methods(options), generate.FOLDER)
    if not scores.get(run.OWN):
        raise entries.EntryError(f"{generate.FOLDER}: no case has a score of every method; run the methods first")
    run.write(RESULTS, {"benchmark": 1, "scores": scores})
    _page(options)
    print(f"written: {RESULTS}, {PAGE}, {README}")


def _page(options):
    from benchmarks.recovery import page

    scores = json.loads(RESULTS.read_text(encoding="utf-8"))["scores"]
    for path, blocks in ((PAGE, page.blocks(scores)), (README, {"benchmark": page.readme(scores)})):
        path.write_text(page.with_blocks(path.read_text(encoding="utf-8"), blocks), encoding="utf-8")


def facts(there):
    """{case: lens, what is stated of it, and cells, as text}."""
    return {
        case.name: f"{case.lens} lens, {'not stated' if not case.table.stated else f'stated to {case.table.stated[1]:.0%}'}, "
        f"cells: {case.rule}"
        for case in there
    }


if __name__ == "__main__":
    os.environ.setdefault("XDG_CACHE_HOME", str(generate.FOLDER / "cache"))
    sys.exit(main())
