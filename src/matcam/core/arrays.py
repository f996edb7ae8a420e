"""Formulae that are written once, for arrays of NumPy and of JAX.

`xp` is NumPy's namespace, in which each function is JAX's where an argument is an array of JAX: inside `jax.grad` or `jax.jit`,
or given by the caller. So a formula needs JAX only for derivatives and for compiled programs, and a single number needs
neither the second that JAX takes to import nor a compiled program. `special` is the same for special functions.

Annotations name `jax.Array` for both kinds.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import wraps
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from typing import Any, ParamSpec, TypeVar

import numpy as np

P = ParamSpec("P")
T = TypeVar("T")


def has_jax(*values: Any) -> bool:
    """Tell whether any value, or an element of a tuple or list among them, is an array of JAX."""
    jax = sys.modules.get("jax")
    return jax is not None and _any_of(getattr(jax, "Array", ()), values)


def _any_of(kind: Any, values: Any) -> bool:
    return any(isinstance(v, kind) or (isinstance(v, tuple | list) and _any_of(kind, v)) for v in values)


def is_concrete(value: object) -> bool:
    """Tell whether `value` holds numbers now, rather than a tracer inside a JAX transformation."""
    jax: Any = sys.modules.get("jax")
    return not (hasattr(jax, "core") and isinstance(value, jax.core.Tracer))


def constant(value: T) -> T:
    """Return the same numbers without their derivatives."""
    return import_module("jax").lax.stop_gradient(value) if has_jax(value) else value


def first_axis_map(function: Callable[..., Any], arrays: tuple[Any, ...], together: int) -> Any:
    """Apply a function to pieces of arrays and join the results, so that intermediate results stay small.

    Args:
        function: takes a piece of each array, and returns an array of as many elements along the first axis.
        arrays: arrays whose first axes are of one length.
        together: elements in a piece.
    """
    if has_jax(arrays):
        one = lambda piece: function(*(array[None] for array in piece))[0]  # noqa: E731
        return import_module("jax").lax.map(one, arrays, batch_size=together)
    count = arrays[0].shape[0]
    pieces = [slice(start, start + together) for start in range(0, max(count, 1), together)]
    return xp.concatenate([function(*(array[piece] for array in arrays)) for piece in pieces])


def repeated(count: int, step: Callable[[T], T], state: T) -> T:
    """Apply a step to a tuple of arrays several times, all of which are of JAX where one is."""
    if has_jax(state):
        return import_module("jax").lax.fori_loop(0, count, lambda _, now: step(now), state)
    for _ in range(count):
        state = step(state)
    return state


def compiled_by_jax(function: Callable[P, T], *, static: tuple[int, ...] = ()) -> Callable[P, T]:
    """Compile a function for arrays of JAX, and call it as it is for those of NumPy.

    Args:
        function: a function of positional arguments.
        static: places of arguments that are no arrays. Default: none.
    """
    programs: list[Callable[P, T]] = []

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        if not has_jax(*args):
            with np.errstate(all="ignore"):
                return function(*args, **kwargs)
        if not programs:
            programs.append(import_module("jax").jit(function, static_argnums=static))
        return programs[0](*args, **kwargs)

    return call


def with_derivatives(function: Callable[P, T], *derivatives: Callable[..., Any]) -> Callable[P, T]:
    """Give a function derivatives of its own, one for each argument, as `jax.custom_jvp` takes them.

    Args:
        function: a function of positional arguments.
        derivatives: each takes the change of its argument, the result and all arguments.
    """
    known: list[Any] = []

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        if not has_jax(*args):
            return function(*args, **kwargs)
        if not known:
            known.append(import_module("jax").custom_jvp(function))
            known[0].defjvps(*derivatives)
        return known[0](*args, **kwargs)

    return call


class _Namespace:
    """Functions of NumPy or SciPy, each of which is that of JAX where an argument is an array of JAX."""

    def __init__(self, numpy_home: str, jax_home: str):
        self._homes = numpy_home, jax_home

    def __getattr__(self, name: str) -> Any:
        own = getattr(import_module(self._homes[0]), name)
        found = own if isinstance(own, type) or not callable(own) else self._choosing(name, own)
        setattr(self, name, found)
        return found

    def _choosing(self, name: str, own: Callable[..., Any]) -> Callable[..., Any]:
        def function(*args: Any, **kwargs: Any) -> Any:
            if has_jax(*args, *kwargs.values()):
                return getattr(import_module(self._homes[1]), name)(*args, **kwargs)
            with np.errstate(all="ignore"):  # as in JAX, infinity and NaN are results like any other
                return own(*args, **kwargs)

        function.__name__ = name
        return function


xp: Any = _Namespace("numpy", "jax.numpy")
special: Any = _Namespace("scipy.special", "jax.scipy.special")
linalg: Any = _Namespace("numpy.linalg", "jax.numpy.linalg")
fft: Any = _Namespace("numpy.fft", "jax.numpy.fft")


# ------------------------------------------------------------------------------------------------------- when JAX comes

_awaiting: list[Callable[[Any], None]] = []


def when_jax_is_there(action: Callable[[Any], None]) -> None:
    """Run an action with the module of JAX: at once where it is imported, otherwise as soon as it is."""
    jax = sys.modules.get("jax")
    if hasattr(jax, "tree_util"):
        action(jax)
    else:
        _awaiting.append(action)


def prepare_jax() -> None:
    """Let JAX compute in float64, and run the actions that wait for it."""
    jax = import_module("jax")
    jax.config.update("jax_enable_x64", True)
    while _awaiting:
        _awaiting.pop(0)(jax)


class _JaxWatcher(MetaPathFinder):
    """Prepare JAX as soon as anybody imports it: a camera that was made before must be a pytree after."""

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        """Find JAX once, with a loader that prepares it."""
        if fullname != "jax":
            return None
        sys.meta_path.remove(self)
        spec = find_spec(fullname)
        if spec is not None and spec.loader is not None:
            load = spec.loader.exec_module

            def exec_module(module: Any) -> None:
                load(module)
                prepare_jax()

            spec.loader.exec_module = exec_module  # type: ignore[method-assign]
        return spec


if "jax" in sys.modules:
    prepare_jax()
else:
    sys.meta_path.insert(0, _JaxWatcher())
