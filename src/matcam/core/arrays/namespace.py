"""Namespaces for formulas on arrays of NumPy and of JAX.

`xp` contains the functions of NumPy. Each function calls the function of JAX instead if an argument is an array of JAX. This
is the case inside `jax.grad` and `jax.jit`, or if the caller passes such an array. A formula therefore requires JAX only for
derivatives and compiled programs, and the evaluation of a single number does not import JAX. `special`, `linalg` and `fft`
are the corresponding namespaces of special functions, linear algebra and Fourier transforms.

The annotation `jax.Array` stands for arrays of both kinds.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

T = TypeVar("T")
FloatArray = npt.NDArray[np.float64]


_PLAIN = frozenset(
    {np.ndarray, *np.sctypeDict.values(), float, int, complex, bool, str, slice, type, type(None), type(...)}
)
"""Types that are not arrays of JAX. A comparison of types is faster than `isinstance` for `jax.Array`."""


def has_jax(*values: Any) -> bool:
    """Check whether any value is an array of JAX, or a tuple or list that contains one."""
    jax = sys.modules.get("jax")
    if jax is None:
        return False
    for value in values:  # faster than `any`; this function is called for every operation
        if type(value) in _PLAIN:
            continue
        if isinstance(value, tuple | list):
            if has_jax(*value):
                return True
        elif isinstance(value, getattr(jax, "Array", ())):
            return True
    return False


def is_concrete(value: object) -> bool:
    jax: Any = sys.modules.get("jax")
    return not (hasattr(jax, "core") and isinstance(value, jax.core.Tracer))


def constant(value: T) -> T:
    """Return a value unchanged, but treat it as a constant in derivatives."""
    return import_module("jax").lax.stop_gradient(value) if has_jax(value) else value


_silent: ContextVar[bool] = ContextVar("silent", default=False)


@contextmanager
def without_warnings() -> Iterator[None]:
    """Suppress the warnings of NumPy about infinity and NaN, which JAX does not issue.

    Each function of `xp` also suppresses them, but for small arrays this takes longer than the computation.
    """
    token = _silent.set(True)
    try:
        with np.errstate(all="ignore"):
            yield
    finally:
        _silent.reset(token)


class _Namespace:
    """Functions of NumPy or SciPy. If an argument is an array of JAX, the function of JAX is called instead.

    As in JAX, the result for a singular matrix is NaN.
    """

    def __init__(self, numpy_home: str, jax_home: str):
        self._homes = numpy_home, jax_home

    def __getattr__(self, name: str) -> Any:
        own = getattr(import_module(self._homes[0]), name)
        found = own if isinstance(own, type) or not callable(own) else self._choosing(name, own)
        setattr(self, name, found)
        return found

    def _choosing(self, name: str, own: Callable[..., Any]) -> Callable[..., Any]:
        silently = np.errstate(all="ignore")(own)  # a decorator is faster than a context at each call

        def function(*args: Any, **kwargs: Any) -> Any:
            if has_jax(*args) or (kwargs and has_jax(*kwargs.values())):
                return getattr(import_module(self._homes[1]), name)(*args, **kwargs)
            try:
                return (own if _silent.get() else silently)(*args, **kwargs)
            except np.linalg.LinAlgError:
                return np.full_like(args[-1], np.nan)

        function.__name__ = name
        return function


xp: Any = _Namespace("numpy", "jax.numpy")
special: Any = _Namespace("scipy.special", "jax.scipy.special")
linalg: Any = _Namespace("numpy.linalg", "jax.numpy.linalg")
fft: Any = _Namespace("numpy.fft", "jax.numpy.fft")


# ----------------------------------------------------------------------------------------------- when JAX is imported

_PREPARED = "matcam.core.jax"
"""Module whose import sets JAX to float64 and registers the pytrees."""
_awaiting: list[Callable[[Any], None]] = []


def when_jax_is_there(action: Callable[[Any], None]) -> None:
    """Call a function as soon as JAX is imported, or immediately if JAX is already imported.

    The argument of `action` is the module `jax`.
    """
    jax = sys.modules.get("jax")
    if hasattr(jax, "tree_util"):
        action(jax)
    else:
        _awaiting.append(action)


def jax_is_there(jax: Any) -> None:
    while _awaiting:
        _awaiting.pop(0)(jax)


class _JaxWatcher(MetaPathFinder):
    """Import hook for JAX. It sets JAX to float64, and registers the existing subclasses of `Module` as pytrees."""

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        if fullname != "jax":
            return None
        sys.meta_path.remove(self)
        spec = find_spec(fullname)
        if spec is not None and spec.loader is not None:
            load = spec.loader.exec_module

            def exec_module(module: Any) -> None:
                load(module)
                import_module(_PREPARED)

            spec.loader.exec_module = exec_module  # type: ignore[method-assign]
        return spec


if "jax" in sys.modules:
    import_module(_PREPARED)
else:
    sys.meta_path.insert(0, _JaxWatcher())
