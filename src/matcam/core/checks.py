"""Checks of arguments: conversion to float64, and range checks of concrete values.

Traced values (inside jit, grad, vmap) are not checked, because they are unknown.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import numpy.typing as npt

from matcam.core.arrays import constant, has_jax, is_concrete, xp
from matcam.core.errors import ArgumentError

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import jax


_trusted: ContextVar[bool] = ContextVar("trusted", default=False)


@contextmanager
def trusted() -> Iterator[None]:
    """Disable the checks of type, finiteness and range in a `with` block, because a fit may temporarily leave a range."""
    token = _trusted.set(True)
    try:
        yield
    finally:
        _trusted.reset(token)


T = TypeVar("T")


def number(name: str, value: ArrayLike | npt.ArrayLike) -> jax.Array:
    """Convert `value` to a float64 array of finite numbers.

    An ArgumentError is raised if the value is not numeric or not finite.
    """
    if _trusted.get() or not is_concrete(value):
        return xp.asarray(value, dtype=xp.float64)
    array = _as_float64(name, value)
    if not np.all(np.isfinite(array)):
        raise ArgumentError(f"{name} must be finite, got {_first_bad(array, np.isfinite(array))}")
    return _kept(array, value)


def numbers(name: str, value: ArrayLike | npt.ArrayLike) -> jax.Array:
    """Convert `value` to a float64 array, which may contain NaN.

    An ArgumentError is raised if the value is not numeric.
    """
    return _kept(_as_float64(name, value), value) if is_concrete(value) else xp.asarray(value, dtype=xp.float64)


def within(
    name: str,
    value: ArrayLike,
    low: float,
    high: float,
    unit: str = "",
    *,
    open_low: bool = False,
    open_high: bool = False,
) -> jax.Array:
    """Convert `value` to a float64 array, and check that its elements lie in [low, high].

    `open_low` and `open_high` exclude the ends. A closed infinite end allows infinity itself. An ArgumentError is raised for
    other values; its message contains `unit`.
    """
    if _trusted.get() or not is_concrete(value):
        return xp.asarray(value, dtype=xp.float64)
    array = _as_float64(name, value)
    above = array > low if open_low else array >= low
    below = array < high if open_high else array <= high
    fits = above & below
    if not np.all(fits):
        interval = f"{'(' if open_low else '['}{low:g}, {high:g}{')' if open_high else ']'}"
        hint = degrees_hint(array[~fits].max(), high) if unit.split(" ")[0] == "rad" else ""
        raise ArgumentError(f"{name} must lie in {interval}{unit and ' ' + unit}, got {_first_bad(array, fits)}{hint}")
    return _kept(array, value)


def degrees_hint(value: float, high: float) -> str:
    """Suggest a conversion for an angle that seems to be in degrees.

    Args:
        value: largest given angle.
        high: end of the range, rad.

    Returns:
        Text to append to a message about the range; "" if the angle does not seem to be in degrees.
    """
    beyond = value > max(2 * np.pi if high > 1 else high, high)  # a value below a whole turn may well be in rad
    return f"; if {value:g} is in degrees, give np.radians({value:g})" if beyond and np.radians(value) <= high else ""


def positive(name: str, value: ArrayLike, unit: str = "") -> jax.Array:
    return within(name, value, 0, np.inf, unit, open_low=True, open_high=True)


def scalar(name: str, value: jax.Array) -> jax.Array:
    """Check that a value has no axes. Otherwise an ArgumentError with its shape is raised."""
    if value.ndim:
        raise ArgumentError(f"{name} must be a single number, got an array of shape {value.shape}")
    return value


def outside_jit(value: ArrayLike, what: str) -> float:
    """Convert a concrete parameter to a float, without its derivative.

    Args:
        value: the parameter.
        what: plural name of the parameters, such as "the lamp's parameters", for the message.

    Raises:
        ArgumentError: the parameter is traced, because the call is inside jax.jit or jax.vmap.
    """
    value = constant(value)
    if not is_concrete(value):
        raise ArgumentError(
            f"{what} must have concrete values, because numbers of points and ranges are computed from them: call this "
            "function outside jax.jit and jax.vmap"
        )
    return float(np.asarray(value))


def viewing_angle(name: str, value: ArrayLike) -> jax.Array:
    """Check an angle between a surface normal and a visible direction, [0, pi/2) rad."""
    return within(name, value, 0, np.pi / 2, "rad (below 90 degrees)", open_high=True)


def choice(name: str, value: Any, allowed: tuple[Any, ...]) -> Any:
    """Check that `value` is one of `allowed`. Otherwise an ArgumentError is raised."""
    if not any(_is_one(value, one) for one in allowed):
        raise ArgumentError(f"{name} must be one of {', '.join(map(repr, allowed))}, got {_shown(value)}")
    return value


def _is_one(value: Any, one: Any) -> bool:
    """Compare a value of any type with a choice. An array of several values never matches, and True does not match 1."""
    same = value == one
    return (
        isinstance(same, bool | np.bool_) and bool(same) and isinstance(value, bool | np.bool_) == isinstance(one, bool)
    )


def whole_number(
    name: str, value: Any, low: int, high: int | None = None, *, unit: str = "", optional: bool = False
) -> int | None:
    """Check that `value` is an int in [low, high].

    Without `high` there is no upper limit. None is allowed if `optional` is set. An ArgumentError is raised for any other
    value; its message contains `unit`.
    """
    if (optional and value is None) or (type(value) is int and low <= value and (high is None or value <= high)):
        return value
    interval = f">= {low}" if high is None else f"in [{low}, {high}]"
    hint = "; give a Python int" if isinstance(value, np.integer) else ""
    raise ArgumentError(
        f"{name} must be a whole number{unit and ' of ' + unit} {interval}{' or None' * optional}, got "
        f"{_shown(value)}{hint}"
    )


def flag(name: str, value: Any) -> bool:
    """Check that `value` is True or False, of Python or of NumPy.

    An ArgumentError is raised for other types, because Python would treat a string or an array as true.
    """
    if not isinstance(value, bool | np.bool_):
        raise ArgumentError(f"{name} must be True or False, got {_shown(value)}")
    return bool(value)


def instance(name: str, value: Any, kind: type[T], example: str = "") -> T:
    """Check that `value` is an instance of a class.

    Otherwise an ArgumentError is raised. Its message contains the class and, if given, the Python expression `example`.
    """
    if not isinstance(value, kind):
        such = f" such as {example}" if example else ""
        article = "an" if kind.__name__[0] in "AEIOU" else "a"
        raise ArgumentError(f"{name} must be {article} {kind.__name__}{such}, got {_shown(value)}")
    return value


def instances(name: str, values: Any, kind: type[T]) -> list[T]:
    """Check that a sequence contains only instances of a class, and convert it to a list.

    Otherwise an ArgumentError is raised. Its message contains the class.
    """
    if isinstance(values, str | bytes) or not isinstance(values, Iterable):
        raise ArgumentError(f"{name} must be a sequence of {kind.__name__}, got {_shown(values)}")
    return [instance(f"entry {number} of {name}", value, kind) for number, value in enumerate(values, 1)]


def broadcastable(**values: ArrayLike) -> tuple[jax.Array, ...]:
    """Convert values to finite float64 arrays whose shapes broadcast.

    An ArgumentError is raised if a value is not finite, or if the shapes do not broadcast.
    """
    arrays = {name: number(name, value) for name, value in values.items()}
    broadcast_shape(**arrays)
    return tuple(arrays.values())


def broadcast_shape(**arrays: jax.Array) -> tuple[int, ...]:
    """Compute the common shape of arrays.

    An ArgumentError is raised if the arrays do not broadcast; the message contains their names and shapes.
    """
    shapes = [np.shape(array) for array in arrays.values()]
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        *names, last = arrays
        text = f"{', '.join(names)} and {last} must have shapes that broadcast, got {', '.join(map(str, shapes))}"
        raise ArgumentError(text) from None


def extra(what: str, name: str, module: str) -> None:
    """Check that an optional module is installed.

    Args:
        what: feature that requires the module, for the message.
        name: extra of this package that installs the module, such as "render".
        module: name of the module, which is located but not imported.

    Raises:
        ArgumentError: the module is not installed; the message contains the command that installs it.
    """
    if find_spec(module) is None:
        raise ArgumentError(f"{what} needs optional packages: run python -m pip install 'matcam[{name}]'")


def not_masked(name: str, value: Any) -> None:
    """Raise ArgumentError for an array with masked values.

    Other functions of NumPy would ignore the mask and use the masked values.
    """
    if np.ma.is_masked(value):
        raise ArgumentError(f"{name} must not be masked: use .filled(np.nan) where values are missing, or omit them")


def plain_array(name: str, value: Any) -> np.ndarray:
    """Convert a value to an array of NumPy of any type.

    An ArgumentError is raised if values are masked, or if rows have different lengths.
    """
    not_masked(name, value)
    try:
        return np.asarray(value)
    except ValueError:
        raise ArgumentError(
            f"{name} must be an array with rows of equal length, got a {type(value).__name__} with rows of different lengths"
        ) from None


def _kept(array: np.ndarray, value: Any) -> Any:
    """Convert a checked array to JAX if `value` contains an array of JAX. Otherwise make the array read-only."""
    if has_jax(value):
        from matcam.core.jax import placed

        return placed(array)
    array.setflags(write=False)
    return array


def _as_float64(name: str, value: ArrayLike | npt.ArrayLike) -> np.ndarray:
    not_masked(name, value)
    try:
        array = np.asarray(value)
        if (
            array.dtype.kind not in "biufO"
        ):  # NumPy accepts times and strings as numbers, and the real part of complex numbers
            raise TypeError
        if array.dtype.kind == "O" and any(one is None or isinstance(one, str | bytes) for one in array.flat):
            raise TypeError
        return array.astype(np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ArgumentError(f"{name} must be a number or an array of numbers, got {_shown(value)}") from None


def _shown(value: Any) -> str:
    try:
        return " ".join(repr(value).split())[:60]
    except Exception:  # an integer of ten thousand digits has no repr, and foreign classes have arbitrary ones
        return type(value).__name__


def _first_bad(array: np.ndarray, fits: np.ndarray) -> str:
    return f"{array[~fits].flat[0]:g}"
