"""Run of methods on cases: resumable, and in several processes.

A score is a file in FOLDER/scores, and an answer of the package is a file in FOLDER/answers. Their names contain a hash of
everything that they depend on, so that a second run computes only what is missing or has changed.
"""

import hashlib
import inspect
import json
import multiprocessing
import os
import resource
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from importlib import metadata
from pathlib import Path

import numpy as np
from benchmarks.recovery import baselines, cases, entries, generate, photographs, records, scoring
from benchmarks.recovery.entries import Answer

METHODS = (*baselines.BASELINES, "matcam", "matcam, true lens")
"""All methods that `make benchmark` runs; the last two are the package."""
OWN = "matcam"
_HERE = Path(__file__).resolve().parent
_PAUSE = 0.05
"""Time between two readings of the memory in use, s."""


def scores(chosen, methods, folder, workers=1, say=print):
    """Scores {method: {case: score}} of methods on cases, read where they exist and computed where not."""
    todo = [one for one in chosen if any(not score_path(one, m, folder).exists() for m in methods)]
    if workers == 1:
        for one in todo:
            say(_run_case(one, methods, folder))
    else:
        # the tables that take longest start first
        todo.sort(key=lambda one: -len(one.table.setup.lens) - 50 * (one.rule != "centre"))
        with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
            for line in pool.map(_run_case, todo, [methods] * len(todo), [folder] * len(todo)):
                say(line)
    return kept_scores(chosen, methods, folder)


def kept_scores(chosen, methods, folder):
    """Scores {method: {case: score}} that exist, of the cases that have a score of each method."""
    whole = [one for one in chosen if all(score_path(one, m, folder).exists() for m in methods)]
    return {
        m: {one.name: json.loads(score_path(one, m, folder).read_text(encoding="utf-8")) for one in whole}
        for m in methods
    }


def score_path(case, method, folder):
    """File of a score."""
    scoring_source = (_HERE / "scoring.py").read_text(encoding="utf-8")
    return Path(folder) / "scores" / slug(method) / f"{case.name}-{_digest(case, method, scoring_source)}.json"


def answer_path(case, method, folder):
    """File of an answer."""
    return Path(folder) / "answers" / slug(method) / f"{case.name}-{_digest(case, method)}.npz"


def _digest(case, method, *more):
    text = f"{records.fingerprint(case)} {case!r} {_sources(method, photographs.is_photographs(case))} {more}"
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def slug(method):
    """Name of a method as part of a file name."""
    return "".join(c if c.isalnum() else "-" for c in method.lower()).strip("-")


@cache
def _sources(method, from_photographs):
    """Hash of the sources that an answer depends on besides the case."""
    texts = [(_HERE / "generate.py").read_bytes()]
    texts += [photographs.sources()] if from_photographs else []
    if method in baselines.BASELINES:
        texts.append((_HERE / "baselines.py").read_bytes())
        texts.append(metadata.version("scikit-image").encode() if method in baselines.RESTORED else b"")
    else:
        texts.append((_HERE / "package.py").read_bytes())
        texts += [(_HERE / "package_photographs.py").read_bytes()] if from_photographs else []
        texts += [path.read_bytes() for path in sorted((generate.ROOT / "src" / "matcam").rglob("*.py"))]
    return hashlib.sha256(b"".join(texts)).hexdigest()


def _run_case(case, methods, folder):
    """Compute the missing scores of one case, and describe them in a line."""
    started = time.process_time()
    table, given, facts = data(case, folder)
    costs = [f"table {time.process_time() - started:.0f} s"]
    for method in methods:
        path = score_path(case, method, folder)
        if path.exists():
            continue
        answer, seconds, memory = _kept_answer(case, method, folder, given, facts)
        found = scoring.score(table, *answer, floor=case.table.floor)
        write(path, found | {"seconds": round(seconds, 1), "memory_mib": round(memory)})
        costs.append(f"{method} {seconds:.1f} s")
    return f"{case.name}: {', '.join(costs)}"


def data(case, folder):
    """Table with which answers are compared, what an entrant receives (a table or photographs), and what is stated of it."""
    if photographs.is_photographs(case):
        made = photographs.photographs(case, folder)
        return photographs.table(case, made), made.noisy, photographs.stated(case, made)
    table = generate.table(case, folder)
    return table, table.recorded, cases.stated(case)


def _kept_answer(case, method, folder, given, facts):
    """Answer of a method, its time and memory (`measured`); those of the package are kept in float32."""
    path = answer_path(case, method, folder)
    if path.exists():
        with np.load(path) as file:
            return Answer(file["value"], file["std"], file["supported"]), float(file["seconds"]), float(file["memory"])
    answer, seconds, memory = measured(lambda: answer_of(method, given, case, facts))
    if method not in baselines.BASELINES:
        std = np.minimum(answer.std, np.finfo(np.float32).max)
        answer = Answer(np.float32(answer.value), np.float32(std), answer.supported)
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = path.with_name(f"{path.stem}.{os.getpid()}.partial.npz")
        np.savez(temporary, **answer._asdict(), seconds=seconds, memory=memory)
        temporary.replace(path)
    return answer, seconds, memory


def answer_of(method, given, case, facts):
    """Answer of a method for a recorded table or for photographs."""
    from_photographs = photographs.is_photographs(case)
    if method in baselines.BASELINES:
        if from_photographs:
            return Answer(baselines.on_pictures(method, given, facts))
        return Answer(baselines.BASELINES[method](given, facts))
    from benchmarks.recovery import package, package_photographs

    from matcam.core.jax import use_compilation_cache

    use_compilation_cache()
    methods = package_photographs.PACKAGE if from_photographs else package.PACKAGE
    return methods[method](given, case, facts)


def measured(work):
    """Result of a call, its processor time, s, and the largest resident memory of the process during it, MiB."""
    largest, done = [0.0], threading.Event()

    def watch():
        page = resource.getpagesize() / 2**20
        while True:
            largest[0] = max(largest[0], int(Path("/proc/self/statm").read_text().split()[1]) * page)
            if done.wait(_PAUSE):
                return

    watching = threading.Thread(target=watch, daemon=True)
    watching.start()
    started = time.process_time()
    try:
        return work(), time.process_time() - started, largest[0]
    finally:
        done.set()
        watching.join()


def entry_scores(entry, chosen, folder):
    """Scores {case: score} of an entry on the cases for which it has a table."""
    found = {}
    for case in chosen:
        if case.name in entry.files:
            answer = entries.read(entry.files[case.name])
            score = scoring.score(data(case, folder)[0], *answer, floor=case.table.floor)
            found[case.name] = score | {
                "seconds": entry.seconds.get(case.name),
                "memory_mib": entry.memory.get(case.name),
            }
    return found


def write(path, document):
    """Write a document as JSON; the file appears whole or not at all."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f"{path.name}.{os.getpid()}.partial")
    temporary.write_text(json.dumps(rounded(document), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    temporary.replace(path)


def rounded(document):
    """Document with numbers of 8 digits; what is not finite becomes None."""
    if isinstance(document, dict):
        return {key: rounded(value) for key, value in document.items()}
    if isinstance(document, list | tuple):
        return [rounded(value) for value in document]
    if isinstance(document, float | np.floating):
        return float(f"{document:.8g}") if np.isfinite(document) else None
    return document


def describe(method, from_photographs=False):
    """First sentence on a method."""
    if method in baselines.BASELINES:
        return inspect.getdoc(baselines.BASELINES[method]).split("\n\n")[0].replace("\n", " ")
    from benchmarks.recovery import package, package_photographs

    methods = package_photographs.PACKAGE if from_photographs else package.PACKAGE
    return inspect.getdoc(methods[method]).split("\n\n")[0].replace("\n", " ")
