"""Immutable objects whose parameters are arrays: cameras, lobes, samples.

They are pytrees of JAX, as the modules of Equinox are. This module does not import JAX: the classes are registered as pytrees
when JAX is imported.
"""

from __future__ import annotations

import dataclasses
from abc import ABC
from collections.abc import Mapping
from typing import Any, TypeVar, dataclass_transform

import numpy as np

from matcam.core.arrays.namespace import is_concrete, when_jax_is_there

M = TypeVar("M", bound="Module")


def static_field(**options: Any) -> Any:
    """Declare a field that is not an array, as `equinox.field(static=True)` does.

    The value of the field is part of the structure of the pytree.
    """
    return dataclasses.field(metadata={"static": True}, **options)


@dataclass_transform(eq_default=False, field_specifiers=(static_field,))
class Module(ABC):  # noqa: B024  # subclasses have abstract methods
    """Base class of immutable objects. Their annotated attributes are arrays, other modules, or static fields.

    A class without a constructor gets the constructor of a dataclass. An attribute can be set only once, in the constructor.
    """

    def __init_subclass__(cls, **options: Any):
        super().__init_subclass__(**options)
        given = cls.__init__ is not object.__init__ and not hasattr(cls.__init__, "_of_fields")
        dataclasses.dataclass(init=not given, repr=False, eq=False)(cls)
        if not given:
            cls.__init__._of_fields = True  # type: ignore[attr-defined]
        when_jax_is_there(lambda jax: _register(jax, cls))

    def __setattr__(self, name: str, value: Any) -> None:
        if name in self.__dict__ or name not in self.__dataclass_fields__:  # type: ignore[attr-defined]
            raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")
        self.__dict__[name] = value

    def __delattr__(self, name: str) -> None:
        raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(_equal(getattr(self, name), getattr(other, name)) for name in self.__dataclass_fields__)  # type: ignore[attr-defined]

    __hash__ = None  # type: ignore[assignment]  # arrays have no hash

    def __repr__(self) -> str:
        return constructor_call(self)


def constructor_call(thing: Any, arguments: Mapping[str, Any] | None = None) -> str:
    """Format an object as a call of its constructor.

    Args:
        thing: instance of a dataclass, such as a module.
        arguments: values of the arguments by name. Default: None, the fields of the dataclass.

    Example:
        >>> constructor_call(matcam.Conductor([0.2, 0.3], [3.5, 4.0]))
        'Conductor(n=[0.2, 0.3], k=[3.5, 4.0])'
    """
    if arguments is None:
        arguments = {field.name: getattr(thing, field.name) for field in dataclasses.fields(thing)}
    shown = ", ".join(f"{name}={_in_words(value)}" for name, value in arguments.items())
    return f"{type(thing).__name__}({shown})"


def _in_words(value: Any) -> str:
    if not hasattr(value, "dtype"):
        return repr(value)
    if not is_concrete(value):
        return str(value)
    array = np.asarray(value)
    # an array of more entries than four rows of four is described by its shape and range
    if array.size <= 16 or array.dtype.kind not in "biuf":
        return repr(array.tolist())
    shape, finite = " x ".join(map(str, array.shape)), array[np.isfinite(array)]
    span = f" from {finite.min():.6g} to {finite.max():.6g}" if finite.size else ""
    return f"<{shape} values{span}>"


def replaced(module: M, path: str, value: Any) -> M:
    """Copy an object with one attribute replaced. The checks of the constructor are omitted.

    Args:
        module: the object.
        path: path of the attribute, such as "core.sigma".
        value: new value of the attribute.
    """
    name, _, rest = path.partition(".")
    new = object.__new__(type(module))
    inner = replaced(getattr(module, name), rest, value) if rest else value
    new.__dict__.update(module.__dict__ | {name: inner})
    return new


def leaves_of(value: Any) -> list[Any]:
    if isinstance(value, Module):
        return [leaf for name in _names(type(value))[0] for leaf in leaves_of(getattr(value, name))]
    if isinstance(value, tuple | list):
        return [leaf for one in value for leaf in leaves_of(one)]
    return [] if value is None else [value]


def _equal(a: Any, b: Any) -> bool:
    if isinstance(a, tuple | list):
        return type(a) is type(b) and len(a) == len(b) and all(map(_equal, a, b))
    if hasattr(a, "dtype") and hasattr(b, "dtype") and is_concrete(a) and is_concrete(b):
        return a.dtype == b.dtype and np.array_equal(a, b)
    return bool(a == b)


def _names(cls: type) -> tuple[tuple[str, ...], tuple[str, ...]]:
    fields = dataclasses.fields(cls)
    static = tuple(field.name for field in fields if field.metadata.get("static"))
    return tuple(field.name for field in fields if field.name not in static), static


def _register(jax: Any, cls: type) -> None:
    dynamic, static = _names(cls)
    keys = tuple(map(jax.tree_util.GetAttrKey, dynamic))
    of_dynamic, of_static = map(_getter, (dynamic, static))

    def flatten(module: Any) -> tuple[Any, Any]:
        return of_dynamic(module.__dict__), of_static(module.__dict__)

    def flatten_with_keys(module: Any) -> tuple[Any, Any]:
        return tuple(zip(keys, of_dynamic(module.__dict__), strict=True)), of_static(module.__dict__)

    def unflatten(kind: Any, parts: Any) -> Any:
        module: Any = object.__new__(cls)
        module.__dict__.update(zip(dynamic, parts, strict=True))
        module.__dict__.update(zip(static, kind, strict=True))
        return module

    jax.tree_util.register_pytree_with_keys(cls, flatten_with_keys, unflatten, flatten)


def _getter(names: tuple[str, ...]) -> Any:
    return lambda values: tuple([values[name] for name in names])
