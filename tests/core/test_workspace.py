"""What a workspace keeps, what it lets go, and that a broken disk is no harm."""

import errno
import os
import pickle
import subprocess
import sys

import numpy as np
import pytest

from matcam.core import jax as jax_module
from matcam.core.errors import ArgumentError
from matcam.core.workspace import Workspace, default_workspace, user_cache_folder


class Counted:
    """A function that counts its calls."""

    def __init__(self):
        self.calls = 0

    def __call__(self):
        self.calls += 1
        return {"a": np.arange(3.0)}


def test_rules_are_kept_on_disk_and_made_again_when_broken(tmp_path, caplog):
    make = Counted()
    workspace = Workspace(tmp_path)
    for _ in range(2):
        np.testing.assert_array_equal(workspace.store("rig", make)["a"], [0, 1, 2])
    assert make.calls == 1
    (file,) = tmp_path.glob("*.arrays")
    file.write_bytes(b"not an archive")
    workspace.store("rig", make)
    assert caplog.messages == [f"matcam: {file.name} in the cache is damaged: it is computed again"]
    assert make.calls == 2
    workspace.store("another rig", make)
    assert make.calls == 3
    # another process finds them
    pickle.loads(pickle.dumps(workspace)).store("another rig", make)
    assert make.calls == 3


def test_no_flipped_bit_is_believed(tmp_path, caplog, monkeypatch):
    """Each of 1,200 is noticed: the arrays are those that were made, and then the file is whole again."""
    random = np.random.default_rng(7)
    arrays = {"weights": random.random((5, 7)), "places": np.arange(11), "none": np.zeros((0, 3))}
    store = Workspace(tmp_path).store
    store("rig", lambda: arrays)
    (file,) = tmp_path.glob("*.arrays")
    whole = file.read_bytes()

    def full(*given, **options):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as context:
        context.setattr(os, "replace", full)  # a flip is not mended before the next one
        for bit in random.choice(8 * len(whole), 1200, replace=False).tolist():
            damaged = bytearray(whole)
            damaged[bit // 8] ^= 1 << bit % 8
            file.write_bytes(damaged)
            assert store("rig", lambda: arrays) is arrays, bit
        assert len(caplog.messages) == 1200
        for cut in (0, 1, 31, 32, 33, len(whole) - 1):
            file.write_bytes(whole[:cut])
            assert store("rig", lambda: arrays) is arrays
    store("rig", lambda: arrays)
    assert file.read_bytes() == whole
    found = store("rig", lambda: pytest.fail("made again"))
    assert found.keys() == arrays.keys()
    for name, array in arrays.items():
        np.testing.assert_array_equal(found[name], array)
        assert (found[name].dtype, found[name].shape) == (array.dtype, array.shape)


_COMPILED = """
import logging, sys, warnings
warnings.simplefilter("error")
from matcam.core.jax import jax, jnp, use_compilation_cache
use_compilation_cache()
print(float(jax.jit(lambda x: jnp.sin(x) + 1)(0.5)))
"""


def test_no_flipped_bit_of_a_compiled_function_is_run(tmp_path):
    """Damaged machine code is compiled again, with one line for each file, and then is whole."""

    def run():
        return subprocess.run(
            [sys.executable, "-c", _COMPILED], env={**os.environ, "XDG_CACHE_HOME": str(tmp_path)}, text=True,
            capture_output=True, check=True,
        )  # fmt: skip

    first = run()
    files = list((tmp_path / "matcam" / "compiled").glob("*.xla"))
    assert files
    whole = {file.name: file.read_bytes() for file in files}
    for number, file in enumerate(files):
        content = bytearray(whole[file.name])
        content[len(content) * (number + 1) // (len(files) + 1)] ^= 16
        file.write_bytes(content)
    again = run()
    assert again.stdout == first.stdout
    said = again.stderr.splitlines()
    assert sorted(said) == sorted(f"matcam: {name} in the cache is damaged: it is computed again" for name in whole)
    assert run().stderr == ""


def test_another_s_file_is_not_believed(tmp_path):
    make = Counted()
    for name in ("rig", "another rig"):
        Workspace(tmp_path).store(name, make)
    first, second = tmp_path.glob("*.arrays")
    first.write_bytes(second.read_bytes())
    for name in ("rig", "another rig"):
        Workspace(tmp_path).store(name, make)
    assert make.calls == 3


def test_the_cache_of_compiled_functions_has_a_limit(tmp_path, monkeypatch):
    monkeypatch.setattr(jax_module, "_LARGEST_CACHE", 1000)
    for age, name in enumerate(("new", "middle", "old")):
        (tmp_path / name).write_bytes(bytes(400))
        os.utime(tmp_path / name, (1e9 - age, 1e9 - age))
    (tmp_path / "empty").touch()
    jax_module._trim(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"new", "middle"}
    jax_module._trim(tmp_path / "none")


def test_another_version_of_the_package_makes_its_own(tmp_path, monkeypatch):
    make = Counted()
    Workspace(tmp_path).store("rig", make)
    monkeypatch.setattr("importlib.metadata.version", lambda name: "0.0.0")
    Workspace(tmp_path).store("rig", make)
    assert make.calls == 2


@pytest.mark.parametrize(("most", "left"), [(12, 12), (3, 3), (0, 0)])
def test_the_latest_files_stay(tmp_path, most, left):
    workspace = Workspace(tmp_path, files=most)
    for number in range(14):
        workspace.store(str(number), Counted())
    assert len(list(tmp_path.glob("*.arrays"))) == left


def test_a_folder_that_cannot_be_written_is_no_harm(tmp_path):
    (tmp_path / "file").write_text("in the way")
    make = Counted()
    assert Workspace(tmp_path / "file" / "rules").store("rig", make)["a"].size == 3
    assert make.calls == 1


def test_memory_keeps_the_latest_used_of_each_kind():
    workspace, made = Workspace(entries=2), []

    def ask(kind, key):
        return workspace.remember(kind, key, lambda: made.append((kind, key)) or key)

    for key in (1, 2, 1, 3, 1):  # 2 was used before 1 was used again: it goes
        assert ask("rule", key) == key
    ask("lattice", 1)
    ask("rule", 2)
    assert made == [("rule", 1), ("rule", 2), ("rule", 3), ("lattice", 1), ("rule", 2)]


def test_large_kinds_and_no_memory():
    make = Counted()
    workspace = Workspace()
    for key in (1, 2, 1):
        workspace.remember("table", key, make, most=1)
    assert make.calls == 3
    for _ in range(2):
        Workspace(entries=0).remember("table", 1, make)
    assert make.calls == 5


def test_a_failure_is_not_kept():
    workspace = Workspace()
    with pytest.raises(ZeroDivisionError):
        workspace.remember("rule", 1, lambda: 1 / 0)
    assert workspace.remember("rule", 1, lambda: 5) == 5


def test_the_default_is_one_and_writes_nothing():
    assert default_workspace() is default_workspace()
    made = default_workspace.__wrapped__()  # the tests have given that of their process a folder
    assert made.folder is None


def test_the_user_s_folder_is_where_the_system_has_it(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert user_cache_folder() == tmp_path / "matcam"
    assert Workspace.user().folder == tmp_path / "matcam" / "rules"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert "matcam" in user_cache_folder().name
    assert tmp_path in user_cache_folder().parents


@pytest.mark.parametrize("bad", [{"entries": -1}, {"files": 1.5}, {"entries": True}])
def test_bad_limits_are_refused(bad):
    (name,) = bad
    with pytest.raises(ArgumentError, match=f"{name} must be a whole number >= 0, got"):
        Workspace(**bad)
