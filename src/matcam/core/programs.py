"""Cache on disk of compiled programs that are ready to run: the next process does not trace or lower them again.

The cache of JAX saves only the work of XLA. To find a function in it, JAX must trace the function in Python and lower it. These
steps take as long as the arithmetic of a short command. The key of the cache in this module consists of the source of the
package, the versions of the libraries, the kind of processor, the name of the function, and the kinds of the arguments.
"""

from __future__ import annotations

import hashlib
import logging
import os
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from functools import cache, partial, wraps
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec, TypeVar, get_args, get_origin, get_type_hints, overload

import equinox as eqx
import jaxlib
import numpy as np

from matcam.core.jax import AnyArray, Runs, jax, plainly_compiled, program_folder
from matcam.core.packed_programs import pack_program, unpack_program
from matcam.core.sealed import CompiledFunctions, read_sealed, write_sealed

P = ParamSpec("P")
T = TypeVar("T")

_ARRAYS = (jax.Array, np.ndarray, np.generic)
_MOST_HELD = 30 << 20
"""Largest total size on disk of the programs that a process keeps in memory, bytes.

In memory they take twenty times as much, 600 MiB.
"""
_log = logging.getLogger("matcam")


@overload
def kept_program(function: Callable[P, T]) -> Callable[P, T]: ...
@overload
def kept_program(*, runs: Runs = "some", returns: Any = None) -> Callable[[Callable[P, T]], Callable[P, T]]: ...
def kept_program(function: Callable[P, T] | None = None, *, runs: Runs = "some", returns: Any = None) -> Any:
    """Compile a function as `eqx.filter_jit` does, and cache the program.

    Programs are cached for the CPU backend with one device, after a call of `use_compilation_cache`. The program is not cached
    if the function is called inside another transformation of JAX, or if an argument has no persistent description.

    Args:
        function: a function of positional arguments, which returns an array or a tuple of arrays. Arrays are traced;
            all other arguments are part of the key of the cache. Default: None, a decorator is returned.
        runs: expected number of runs, as in `plainly_compiled`. Default: "some".
        returns: class of the result if it is a named tuple, or `tuple[...]` of such classes. Default: None, for other
            results.

    Returns:
        The compiled function.

    Example:
        >>> from matcam.core.programs import kept_program
        >>> double = kept_program(lambda x: 2 * x)
        >>> float(double(np.array(4.0)))
        8.0
    """
    if function is None:
        return partial(_kept_program, runs=runs, returns=returns)
    return _kept_program(function, runs=runs, returns=returns)


def _kept_program(function: Callable[P, T], *, runs: Runs, returns: Any) -> Callable[P, T]:
    compiled = eqx.filter_jit(function)
    making = threading.RLock()

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        folder = program_folder()
        if kwargs or folder is None or getattr(jax.config, "jax_disable_jit", False) or not _one_processor():
            return compiled(*args, **kwargs)
        leaves, tree = jax.tree.flatten(args)
        kinds = tuple(_kind(leaf) for leaf in leaves)
        if _TRACED in kinds:
            return compiled(*args, **kwargs)
        key, result = (making, tree, kinds), None  # the lock identifies the function
        found = _held(key)
        if found is None:
            with making:  # threads that call a new program wait for it instead of compiling it again
                found = _held(key)
                if found is None:
                    found, result = _program(function, leaves, tree, kinds, runs, returns, folder)
                    _hold(key, found)
        if result is not None:
            return result
        return compiled(*args, **kwargs) if found.run is None else found.run(*_arrays(leaves))

    return call


_TRACED = ("traced",)


def _kind(leaf: Any) -> tuple[Any, ...]:
    if isinstance(leaf, jax.core.Tracer):
        return _TRACED
    if isinstance(leaf, _ARRAYS):
        return "array", leaf.shape, str(leaf.dtype), bool(getattr(leaf, "weak_type", False))
    return type(leaf).__qualname__, leaf


def _arrays(leaves: list[Any]) -> list[Any]:
    return [leaf for leaf in leaves if isinstance(leaf, _ARRAYS)]


@cache
def _one_processor() -> bool:
    return jax.default_backend() == "cpu" and jax.device_count() == 1


class _Program(NamedTuple):
    """Program that is ready to run.

    Attributes:
        run: function whose arguments are the arrays among the arguments of a call. None: the call has no key, so the program
            is not cached.
        size: size of the program on disk, bytes; 0 if it is not on disk. Default: 0.
    """

    run: Callable[..., Any] | None
    size: int = 0


_programs: OrderedDict[Hashable, _Program] = OrderedDict()
"""Programs in memory, the most recently used last."""
_lock = threading.Lock()


def _held(key: Hashable) -> _Program | None:
    """Look up a program in memory, and mark it as the most recently used."""
    with _lock:
        found = _programs.get(key)
        if found is not None:
            _programs.move_to_end(key)
        return found


def _hold(key: Hashable, program: _Program) -> None:
    """Keep a program in memory, and drop the least recently used programs, which can be read from disk again."""
    with _lock:
        _programs[key] = program
        total = sum(one.size for one in _programs.values())
        for old in [one for one in _programs if _programs[one].size][:-1]:
            if total <= _MOST_HELD:
                break
            total -= _programs.pop(old).size


def _program(
    function: Callable[..., Any],
    leaves: list[Any],
    tree: Any,
    kinds: tuple[Any, ...],
    runs: Runs,
    returns: Any,
    folder: Path,
) -> tuple[_Program, Any]:
    """Load the program of a call from disk, or compile and store it.

    `leaves`, `tree` and `kinds` describe the arguments of the call. `runs` and `returns` are the arguments of `kept_program`.

    Returns:
        The program, and the result of the call. The result is None unless the program was loaded from disk.
    """

    def of_its_kind(program: Callable[..., Any]) -> Callable[..., Any]:
        if returns is None:
            return program
        structure = jax.tree.structure(_positions(returns))
        return lambda *arrays: jax.tree.unflatten(structure, program(*arrays))

    def of_arrays(*arrays: Any) -> Any:  # JAX keeps this function in memory, so it must not refer to the leaves
        given = iter(arrays)
        arguments = [next(given) if kind[0] == "array" else kind[1] for kind in kinds]
        result = function(*jax.tree.unflatten(tree, arguments))
        return result if returns is None else tuple(jax.tree.leaves(result))

    of_arrays.__name__ = function.__name__
    name = f"{function.__module__}.{function.__qualname__}"
    description = f"{name}\n{tree}\n{_types(tree)}\n{kinds!r}\n{runs}\n{returns}"
    if " at 0x" in description or (made_of := _surroundings()) is None:
        return _Program(None), None
    key = f"{made_of}\n{description}".encode()
    path = folder / f"{hashlib.sha256(key).hexdigest()[:40]}.program"
    stored = read_sealed(path, key)
    if stored is not None:
        try:
            program = of_its_kind(unpack_program(bytes(stored)))
            result = jax.block_until_ready(program(*_arrays(leaves)))  # some faults appear only at run time
        except Exception as error:  # backends raise arbitrary errors
            _log.warning("matcam: %s in the cache cannot be used (%s): the program is compiled again", path.name, error)
        else:
            return _Program(program, len(stored)), result
    with CompiledFunctions.passed_by():  # programs from the cache of JAX cannot be serialised again
        program = jax.jit(of_arrays, compiler_options=plainly_compiled(runs)).lower(*_arrays(leaves)).compile()
    size = 0
    try:
        packed = pack_program(program)
        write_sealed(path, key, packed)
        size = len(packed) if path.exists() else 0  # a full disk is not an error
    except Exception as error:  # programs that cannot be serialised can still run
        _log.debug("matcam: %s is not cached: %s", name, error)
    return _Program(of_its_kind(program), size), None


def _positions(kind: Any) -> Any:
    if get_origin(kind) is tuple:
        return tuple(map(_positions, get_args(kind)))
    if isinstance(kind, type) and issubclass(kind, tuple):
        return kind(*map(_positions, get_type_hints(kind, localns={"jax": jax, "AnyArray": AnyArray}).values()))
    return 0


def _types(tree: Any) -> list[str]:
    """List the full names of the types in a tree, because the text of a tree contains only short names."""
    data = tree.node_data()
    own = [f"{data[0].__module__}.{data[0].__qualname__}"] if data else []
    return own + [name for child in tree.children() for name in _types(child)]


@cache
def _surroundings() -> str | None:
    """Describe what all programs depend on: source of the package, versions of libraries, flags of XLA, and processor.

    The result is None if the source of the package cannot be read.
    """
    source = hashlib.sha256()
    folder = Path(__file__).parents[1]
    try:
        for path in sorted(folder.rglob("*.py")):
            source.update(f"{path.relative_to(folder)}\n".encode() + path.read_bytes())
    except OSError:
        return None
    try:
        features = [
            line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith(("model name", "flags"))
        ][:2]
    except OSError:
        features = []
    versions = [jax.__version__, jaxlib.__version__, np.__version__, eqx.__version__]
    return repr([source.hexdigest(), versions, os.environ.get("XLA_FLAGS"), features])
