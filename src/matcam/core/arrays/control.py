"""Loops, conditions and derivatives for arrays of NumPy and of JAX."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from importlib import import_module
from typing import Any, ParamSpec, TypeVar

import numpy as np

from matcam.core.arrays.namespace import has_jax, without_warnings, xp

P = ParamSpec("P")
T = TypeVar("T")


def first_axis_map(function: Callable[..., Any], arrays: tuple[Any, ...], together: int) -> Any:
    """Apply a function to pieces of arrays, and join the results.

    The pieces limit the size of intermediate results.

    Args:
        function: function of one piece of each array. It returns an array whose first axis is as long as that of the pieces.
        arrays: arrays whose first axes have the same length.
        together: largest length of a piece along the first axis.
    """
    if has_jax(arrays):
        one = lambda piece: function(*(array[None] for array in piece))[0]  # noqa: E731
        return import_module("jax").lax.map(one, arrays, batch_size=together)
    count = arrays[0].shape[0]
    pieces = [slice(start, start + together) for start in range(0, max(count, 1), together)]
    return xp.concatenate([function(*(array[piece] for array in arrays)) for piece in pieces])


def repeated(count: int, step: Callable[[T], T], state: T) -> T:
    """Apply a step `count` times to an array or a tuple of arrays.

    If one of the arrays is an array of JAX, the results are arrays of JAX.
    """
    if has_jax(state):
        return import_module("jax").lax.fori_loop(0, count, lambda _, now: step(now), state)
    for _ in range(count):
        state = step(state)
    return state


def either(condition: Any, some: Callable[..., T], others: Callable[..., T], *args: Any) -> T:
    """Call `some` with `args` if a condition is true, and `others` otherwise. The condition may be traced."""
    if has_jax(condition):
        return import_module("jax").lax.cond(condition, some, others, *args)
    return some(*args) if condition else others(*args)


def last_of(step: Callable[[Any, Any], tuple[Any, T]], state: Any, inputs: Any) -> T:
    """Call a step for each input in turn, and return the last result.

    `step` is a function of the state and one input. It returns the new state and a result.
    """
    if has_jax(state):
        jax = import_module("jax")
        return jax.tree.map(lambda a: a[-1], jax.lax.scan(step, state, inputs)[1])
    for one in inputs:
        state, found = step(state, one)
    return found


def changed(array: Any, where: Any, value: Any) -> Any:
    if has_jax(array, value):
        return import_module("jax").numpy.asarray(array).at[where].set(value)
    copy = np.array(array)
    copy[where] = value
    return copy


def entries(array: Any, *at: Any) -> Any:
    if has_jax(array, *at):
        array = import_module("jax").numpy.asarray(array)
    return array[at]


def evenly(count: int, most: int) -> np.ndarray:
    """Select up to `most` of `count` indices, evenly spaced and including both ends."""
    return np.unique(np.linspace(0, count - 1, min(most, count)).round().astype(int))


def as_index(number: Any) -> Any:
    return xp.nan_to_num(number).astype(int)


def tuple_map(function: Callable[..., Any], tree: Any, *others: Any) -> Any:
    if not isinstance(tree, tuple):
        return function(tree, *others)
    parts = [tuple_map(function, *them) for them in zip(tree, *others, strict=True)]
    return tree._make(parts) if hasattr(tree, "_make") else tuple(parts)


_STEP = 1e-3
"""Relative step of finite differences of fourth order.

Their error is 1e-12 for functions that are smooth on the scale of the argument.
"""


def jacobian(function: Callable[[Any], Any], at: Any) -> Any:
    """Compute the derivatives of a function with respect to a vector.

    The function returns an array or a tuple of arrays. The derivatives of each array have an additional last axis for
    the elements of the vector. For arrays of NumPy, the derivatives are finite differences, and the function must be smooth
    on a scale of 1.
    """
    if has_jax(at):
        return import_module("jax").jacfwd(function)(at)
    at = np.asarray(at, dtype=np.float64)
    columns = [slope_along(function, at, unit) for unit in np.eye(at.size)]
    if isinstance(columns[0], tuple):
        return tuple(np.stack(part, -1) for part in zip(*columns, strict=True))
    return np.stack(columns, -1)


def slope_along(function: Callable[[Any], Any], at: Any, direction: Any) -> Any:
    """Compute the derivative of function(at + s direction) with respect to s at s = 0.

    For arrays of NumPy, it is a finite difference. The length of `direction` must then be at most the scale on which the
    function is smooth.
    """
    if has_jax(at, direction):
        jax = import_module("jax")
        at, direction = (jax.numpy.asarray(a, dtype=float) for a in (at, direction))
        return jax.jvp(function, (at,), (jax.numpy.broadcast_to(direction, at.shape),))[1]
    near, far = ((function(at + _STEP * k * direction), function(at - _STEP * k * direction)) for k in (1, 2))

    def slope(a: Any, b: Any, c: Any, d: Any) -> Any:
        return (8 * (a - b) - (c - d)) / (12 * _STEP)

    if isinstance(near[0], tuple):
        return tuple(slope(*four) for four in zip(*near, *far, strict=True))
    return slope(*near, *far)


def compiled_by_jax(function: Callable[P, T], *, static: tuple[int, ...] = ()) -> Callable[P, T]:
    """Compile a function with `jax.jit` for calls with arrays of JAX. Other calls are evaluated by NumPy.

    Args:
        function: a function of positional arguments.
        static: indices of arguments that are not arrays. Default: ().
    """
    programs: list[Callable[P, T]] = []

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        if not has_jax(*args):
            with without_warnings():
                return function(*args, **kwargs)
        if not programs:
            programs.append(import_module("jax").jit(function, static_argnums=static))
        return programs[0](*args, **kwargs)

    return call


def with_derivatives(function: Callable[P, T], *derivatives: Callable[..., Any]) -> Callable[P, T]:
    """Define custom derivatives of a function, as `jax.custom_jvp` does.

    Args:
        function: a function of positional arguments.
        derivatives: one function for each argument of `function`, which computes the tangent of the result due to this
            argument. Its arguments are the tangent of this argument, the result, and all arguments of `function`.
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
