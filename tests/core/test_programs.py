"""Programs that are kept on disk: found again by what they are made of, and never run when damaged."""

import os
import pickle
import subprocess
import sys
import time
from collections import OrderedDict, namedtuple
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import pytest

from matcam import GGX, Beckmann
from matcam.core import programs
from matcam.core.jax import jax, jnp
from matcam.core.programs import kept_program
from matcam.core.sealed import CompiledFunctions, write_sealed

X = np.linspace(0.0, 1.0, 5)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(programs, "program_folder", lambda: tmp_path)
    return tmp_path


def counted(traces):
    """A function that notes when it is traced; each call of this makes the same one, as another process would."""

    @kept_program
    def power(x, exponent, lobe=None):
        traces.append(exponent)
        return x**exponent, x if lobe is None else lobe.d(x)

    return power


def test_another_process_does_not_trace(folder):
    traces = []
    power = counted(traces)
    for _ in range(2):
        np.testing.assert_allclose(power(X, 3)[0], X**3)
    assert traces == [3]
    assert len(list(folder.iterdir())) == 1
    again = counted(traces)
    np.testing.assert_array_equal(again(X, 3)[0], power(X, 3)[0])
    np.testing.assert_array_equal(again(X + 1, 3)[1], X + 1)
    assert traces == [3]


def test_threads_compile_a_new_program_once():
    traces = []

    @kept_program
    def slow(x):
        traces.append(x.shape)
        time.sleep(0.3)  # the other thread calls it meanwhile
        return 2 * x

    with ThreadPoolExecutor(2) as pool:
        found = list(pool.map(slow, [X, X + 1]))
    np.testing.assert_array_equal(found, [2 * X, 2 * X + 2])
    assert traces == [X.shape]


def test_what_was_not_used_for_long_is_read_again(folder, monkeypatch):
    traces, read = [], []
    unpack = programs.unpack_program
    monkeypatch.setattr(programs, "unpack_program", lambda packed: read.append(len(packed)) or unpack(packed))
    monkeypatch.setattr(programs, "_programs", OrderedDict())
    power = counted(traces)
    power(X, 2)
    (path,) = folder.iterdir()
    monkeypatch.setattr(programs, "_MOST_HELD", int(2.5 * path.stat().st_size))
    for exponent in (3, 2, 4, 2, 5, 2):  # no more than two are held, and 2 is one of them
        np.testing.assert_allclose(power(X, exponent)[0], X**exponent)
    assert traces == [2, 3, 4, 5]
    assert not read
    np.testing.assert_allclose(power(X, 3)[0], X**3)
    assert traces == [2, 3, 4, 5]
    assert len(read) == 1


class Pair(NamedTuple):
    """Two arrays of a result."""

    first: jax.Array
    second: np.ndarray | np.float64


class Nested(NamedTuple):
    """A result of results."""

    pair: Pair
    own: jax.Array


def test_named_tuples_come_back_as_they_were(folder):
    traces = []

    def made(returns):
        def nested(x):
            traces.append(1)
            found = Nested(Pair(x, 2 * x), jnp.linalg.cholesky(jnp.eye(2) * x[1]))
            return found if returns is Nested else (found, (x, x + 1))

        return kept_program(runs="once", returns=returns)(nested)

    for returns in (Nested, tuple[Nested, tuple[jax.Array, jax.Array]]):
        for _ in range(2):
            result = made(returns)(X)
            found = result if returns is Nested else result[0]
            assert isinstance(found, Nested)
            np.testing.assert_array_equal(found.pair.second, 2 * X)
            np.testing.assert_allclose(found.own, 0.5 * np.eye(2))
            if returns is not Nested:
                np.testing.assert_array_equal(result[1][1], X + 1)
    assert len(traces) == len(list(folder.iterdir())) == 2


def test_another_process_finds_linear_algebra(folder):
    """A program from disk that calls LAPACK before JAX has looked for it."""
    script = (
        "import sys, numpy as np\n"
        "from pathlib import Path\n"
        "from matcam.core import programs\n"
        "programs.program_folder = lambda: Path(sys.argv[1])\n"
        "from matcam.core.jax import jnp\n"
        "def root(x): return jnp.linalg.cholesky(x)\n"
        "print(float(programs.kept_program(root)(4.0 * np.eye(3))[0, 0]))\n"
    )
    for _ in range(2):
        done = subprocess.run([sys.executable, "-c", script, folder], capture_output=True, text=True, check=True)
        assert done.stdout.strip() == "2.0"
    assert len(list(folder.iterdir())) == 1


def test_each_kind_of_argument_has_its_own(folder):
    traces = []
    for exponent in (2, 2.0, 3):
        for x in (X, X[:3], X.astype(np.float32), X[:, None]):
            np.testing.assert_allclose(counted(traces)(x, exponent)[0], x**exponent, rtol=1e-6)
    for lobe in (GGX(0.3), Beckmann(0.3), GGX(0.2)):
        np.testing.assert_allclose(counted(traces)(X, 1, lobe)[1], lobe.d(X), rtol=1e-12)
    assert len(traces) == len(list(folder.iterdir())) == 14  # both roughnesses share one


def test_classes_of_one_name_are_told_apart(folder):
    """A tree's text has short names only."""
    made = [namedtuple("Scale", "by", module=module) for module in ("one", "two")]
    for scale, expected in zip(made, (2, 3), strict=True):
        scaled = kept_program(lambda x, s: x * (2 if type(s).__module__ == "one" else 3))
        np.testing.assert_array_equal(scaled(X, scale(X)), X * expected)
    assert len(list(folder.iterdir())) == 2


def test_within_a_transformation_it_is_traced(folder):
    power = counted([])
    assert float(jax.grad(lambda x: power(x, 3)[0])(2.0)) == 12
    np.testing.assert_allclose(jax.vmap(lambda x: power(x, 2)[0])(jnp.asarray(X)), X**2)
    assert not list(folder.iterdir())


def test_what_has_no_lasting_name_is_not_kept(folder):
    apply = kept_program(lambda f, x: f(x))
    np.testing.assert_allclose(apply(jnp.sin, X), np.sin(X))
    assert not list(folder.iterdir())


def test_a_damaged_or_foreign_program_is_made_again(folder, caplog, monkeypatch):
    traces = []
    counted(traces)(X, 3)
    (path,) = folder.iterdir()
    whole = path.read_bytes()
    for position in np.random.default_rng(1).integers(0, len(whole), 5):
        path.write_bytes(whole[:position] + bytes([whole[position] ^ 4]) + whole[position + 1 :])
        np.testing.assert_allclose(counted(traces)(X, 3)[0], X**3)
    assert len(traces) == 6
    assert "is damaged" in caplog.text
    monkeypatch.setattr(programs, "read_sealed", lambda path, key: b"no program")
    np.testing.assert_allclose(counted(traces)(X, 3)[0], X**3)
    assert "cannot be used" in caplog.text


class _Order:
    """What a pickle may hold: a call of anything."""

    def __init__(self, folder):
        self.folder = folder

    def __reduce__(self):
        return os.mkdir, (str(self.folder),)


FORGED = {
    "any call": lambda folder: pickle.dumps(_Order(folder)),
    "a call in place of trees": lambda folder: b"[0, 1]\n" + pickle.dumps(_Order(folder)),
    "by way of a library": lambda folder: b"[0, 1]\n" + b"cnumpy\nos.mkdir\n(V" + str(folder).encode() + b"\ntR.",
    "from a library": lambda folder: b"[0, 1]\n" + b"cnumpy.testing._private.utils\nrundocs\n(tR.",
    "a module that runs when it is imported": lambda folder: b"[0, 1]\n" + b"cnumpy.f2py.__main__\ndtype\n(tR.",
    "an attribute of a class": lambda folder: b"[0, 1]\n" + b"cbuiltins\ngetattr\n(cnumpy\ndtype\nVnewbyteorder\ntR.",
    "trees without end": lambda folder: b"[" * 100_000 + b"\n",
}


@pytest.mark.parametrize("name", FORGED)
def test_a_forged_program_calls_nothing(folder, caplog, monkeypatch, name):
    """Its seal is right: it was made by somebody who knows how."""
    keys = []
    monkeypatch.setattr(programs, "write_sealed", lambda *given: keys.append(given) or write_sealed(*given))
    traces = []
    counted(traces)(X, 3)
    ((path, key, _),) = keys
    write_sealed(path, key, FORGED[name](folder / "made"))
    np.testing.assert_allclose(counted(traces)(X, 3)[0], X**3)
    assert not (folder / "made").exists()
    assert "cannot be used" in caplog.text
    assert len(traces) == 2


def test_another_source_is_another_program(folder, monkeypatch):
    traces = []
    for source in ("one", "two", "one"):
        monkeypatch.setattr(programs, "_surroundings", lambda source=source: source)
        counted(traces)(X, 3)
    assert len(traces) == len(list(folder.iterdir())) == 2
    monkeypatch.setattr(programs, "_surroundings", lambda: None)
    counted(traces)(X, 3)
    assert len(list(folder.iterdir())) == 2


def test_without_a_folder_nothing_is_kept(folder, monkeypatch):
    monkeypatch.setattr(programs, "program_folder", lambda: None)
    np.testing.assert_allclose(counted([])(X, 2)[0], X**2)
    assert not list(folder.iterdir())


def test_jaxs_own_cache_is_passed_by(tmp_path):
    """What it has loaded cannot be written down again."""
    kept = CompiledFunctions(str(tmp_path / "jax"))
    with CompiledFunctions.passed_by():
        kept.put("a", b"1")
    assert kept.get("a") is None
    kept.put("a", b"1")
    with CompiledFunctions.passed_by():
        assert kept.get("a") is None
    assert kept.get("a") == b"1"
