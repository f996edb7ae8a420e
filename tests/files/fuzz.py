"""Fuzzing with coverage: every reader of texts is fed mutations of what has led to new lines of the package so far.

    MATCAM_FUZZ_SECONDS=3600 python -m tests.files.fuzz [READER ...]

One line for each reader says how many files it read, what they reached, and the slowest. A file that brings a reader down, or
takes it more than two seconds, is kept in `fuzz-found/`; then the exit status is 1. `make test` runs fixed mutations of the
same readers (test_damaged_texts.py), which also bound the memory: what is found here is mended, and becomes a test there.
"""

import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import matcam
from tests.files.mutations import mutated_text, refusal
from tests.files.text_readers import TEXTS, sound

PACKAGE = str(Path(matcam.__file__).parent)
FOUND = Path("fuzz-found")
SECONDS = 2.0
"""What a reader may take for a file of this size, of processor time."""
_AT_ONCE, _LARGEST = 20, 64 << 10


class Reached:
    """The lines of the package that have been executed while it was watching."""

    def __init__(self):
        self.lines = set()

    def __call__(self, frame, event, argument):
        if event == "call" and not frame.f_code.co_filename.startswith(PACKAGE):
            return None
        self.lines.add((frame.f_code, frame.f_lineno))
        return self

    def by(self, call, *arguments):
        """The result of a call, and whether it has reached anything new."""
        before = len(self.lines)
        sys.settrace(self)
        try:
            return call(*arguments), len(self.lines) > before
        finally:
            sys.settrace(None)


def fuzz(name, folder, seconds, seed=0, enough=1000):
    """Attack a reader for some seconds, or until there are enough faults: (files read, lines reached by the first and by all,
    files that reached more, seconds of the slowest, faults)."""
    path = sound(name, folder)
    read = TEXTS[name][2]
    random = np.random.default_rng(seed)
    corpus, reached, faults = [path.read_bytes()], Reached(), []
    reached.by(refusal, read, path)
    first, count, slowest, begin = len(reached.lines), 0, 0.0, time.monotonic()
    while time.monotonic() - begin < seconds and len(faults) < enough:
        parent = corpus[int(random.integers(len(corpus)) if random.random() < 0.5 else len(corpus) - 1)]
        for content in mutated_text(parent, _AT_ONCE, int(random.integers(2**31))):
            path.write_bytes(content)
            start = time.process_time()
            try:
                message, is_new = reached.by(refusal, read, path)
            except Exception as error:
                faults.append((content, f"{type(error).__name__}: {error}"))
                is_new = False
            else:
                if "\n" in (message or ""):
                    faults.append((content, "a message of several lines"))
            took = time.process_time() - start
            if took > SECONDS:
                faults.append((content, f"{took:.1f} s"))
            slowest, count = max(slowest, took), count + 1
            if is_new and 0 < len(content) < _LARGEST:
                corpus.append(content)
    return count, first, len(reached.lines), len(corpus), slowest, faults


def main(names):
    budget = float(os.environ.get("MATCAM_FUZZ_SECONDS", "3600"))
    seed = int(os.environ.get("MATCAM_FUZZ_SEED", str(time.time_ns() % 2**31)))
    names = names or list(TEXTS)
    bad = 0
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            count, first, last, corpus, slowest, faults = fuzz(name, Path(folder) / "a", budget / len(names), seed)
        print(
            f"{name}: {count} files, seed {seed}; lines reached {first} -> {last} by {corpus}; slowest {slowest:.2f} s; "
            f"{len(faults)} faults", flush=True
        )  # fmt: skip
        for k, (content, why) in enumerate(faults[:20]):
            FOUND.mkdir(exist_ok=True)
            (FOUND / f"{name.replace(' ', '-')}-{seed}-{k}").write_bytes(content)
            print(f"  {why[:150]!r}")
        bad += len(faults)
    return bad


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]) > 0)
