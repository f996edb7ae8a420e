"""Damaged files: what a reader has to survive."""

import itertools
import os
import re
import sys
import sysconfig
import time
import tracemalloc
from pathlib import Path

import numpy as np

import matcam
from matcam.core.errors import MatcamError


class _Opened:
    """Files that Python code of this process opens while it is watched; C libraries open theirs unseen."""

    def __init__(self):
        self.watched, self.paths = False, set()
        own = [
            *sysconfig.get_paths().values(),
            sys.prefix,
            sys.base_prefix,
            str(Path(matcam.__file__).parent),
            "/proc",
            "/sys",
            "/dev",
        ]
        self.allowed = tuple(own)
        sys.addaudithook(self)

    def __call__(self, event, arguments):
        if self.watched and event == "open" and not isinstance(arguments[0], int) and arguments[0] is not None:
            self.paths.add(str(Path(os.fsdecode(arguments[0])).resolve()))

    def outside(self, folder):
        """Those that are neither in a folder nor the interpreter's or the package's own."""
        return sorted(path for path in self.paths if not path.startswith((str(folder.resolve()), *self.allowed)))


_opened = _Opened()


def mutated(content, count, seed, header):
    """`count` damaged copies of `content`: bytes of the first `header` changed, the length changed, 64 places behind the
    header changed, in turn. Every third change puts in a value that is likely to hurt."""
    random = np.random.default_rng(seed)
    nasty = [b"\0" * 8, b"\xff" * 8, b"\xff\xff\xff\x7f", b"\0\0\x80\x7f", b"\0\0\xc0\xff", b"\x01", b"\x80"]
    for k in range(count):
        data = bytearray(content)
        if k % 3 == 1:
            if random.random() < 0.5:
                yield bytes(data[: random.integers(0, len(data))])
            else:
                yield bytes(data) + random.bytes(int(random.integers(1, 5000)))
            continue
        low, high, positions = (0, header, random.integers(1, 9)) if k % 3 == 0 else (header, len(data), 64)
        for at in random.integers(low, max(high, low + 1), positions):
            change = nasty[random.integers(len(nasty))] if random.random() < 1 / 3 else random.bytes(1)
            data[at : at + len(change)] = change
        yield bytes(data[: len(content)])


def survives(
    read, path, contents, *, seconds=2.0, times_the_file=4.0, spare=1 << 20, clock=time.perf_counter, folder=None
):
    """How many were refused, how many read. Anything but an error of the family or a result, more than `seconds`, or more
    memory than `times_the_file` (and `spare` bytes for what the interpreter loads) fails here, and a file that is opened
    outside `folder`, by default the file's. `clock` may count processor time, where nothing can wait."""
    refused = accepted = 0
    contents = iter(contents)
    first = next(contents)
    path.write_bytes(first)
    refusal(read, path)  # what is imported on the way belongs to nobody's file
    _opened.paths.clear()
    tracemalloc.start()
    for k, content in enumerate(itertools.chain([first], contents)):
        path.write_bytes(content)
        message, took, used = _measured_refusal(read, path, clock)
        limit = times_the_file * len(content) + spare
        if took >= seconds or used >= limit:  # other threads, late imports and a busy machine count too, but not twice
            message, took, used = _measured_refusal(read, path, clock)
        refused, accepted = refused + (message is not None), accepted + (message is None)
        assert "\n" not in (message or ""), (k, message)
        assert took < seconds, (k, took)
        assert used < limit, (k, used, len(content))
    tracemalloc.stop()
    outside = _opened.outside(folder or path.parent)
    assert not outside, outside
    return refused, accepted


def _measured_refusal(read, path, clock):
    tracemalloc.reset_peak()
    before, start = tracemalloc.get_traced_memory()[0], clock()
    _opened.watched = True
    message = refusal(read, path)
    _opened.watched = False
    return message, clock() - start, tracemalloc.get_traced_memory()[1] - before


def refusal(read, path):
    """What `read` complains about, or None."""
    try:
        read(path)
    except MatcamError as error:
        return str(error)
    return None


_TOKEN = re.compile(rb'-?\d[\d.eE+-]*|"[^"\n]{0,60}"|[A-Za-z_]\w*|[\[\]{},=:\n]')
_NASTY_TOKENS = [
    b'"' + b"x" * 300 + b'"', b'"../x"', b"../x", b'"/etc/passwd"', b"/etc/passwd",
    b"0", b"-1", b"1e999", b"-1e999", b"1e-320", b"nan", b"NaN", b"inf", b"Infinity", b"null", b"true", b"1" * 400, b"9" * 5000,
    b'""', b'"\\u0000"', b'"\\ud800"', b'"' + b"x" * 5000 + b'"', b"[]", b"{}", b"[[1]]", b"\n", b"\x1b[2J", b"\xff",
    b"\xe2\x80\xae", b"=", b"]", b'"a\\nb"', b'"a\\u001b[2J"', b"a." * 800 + b"a",
    b"1979-05-27T07:32:00Z", b"[" * 3000, b'{"a":' * 3000,
]  # fmt: skip


def mutated_text(content, count, seed):
    """`count` damaged copies of a text: in half of them bytes are changed, in the others words: each is replaced by one that
    is likely to hurt or by another of the text, doubled, or left out."""
    random = np.random.default_rng(seed)
    tokens = [(found.start(), found.end()) for found in _TOKEN.finditer(content)]
    damaged = mutated(content, count - count // 2, seed, len(content))
    for k in range(count):
        if k % 2 == 0:
            yield next(damaged)
            continue
        data = content
        for at in sorted(random.integers(len(tokens), size=random.integers(1, 4)), reverse=True):
            start, end = tokens[at]
            other = slice(*tokens[random.integers(len(tokens))])
            choice = random.random()
            nasty = _NASTY_TOKENS[random.integers(len(_NASTY_TOKENS))]
            new = (
                nasty
                if choice < 0.6
                else content[other]
                if choice < 0.8
                else data[start:end] * 2
                if choice < 0.9
                else b""
            )
            data = data[:start] + new + data[end:]
        yield data
