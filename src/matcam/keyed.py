"""A thing with the key by which it is told from others: for caches of what is not hashable itself."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Generic, TypeVar

T = TypeVar("T")


class Keyed(Generic[T]):
    """`thing`, equal to another of the same key."""

    def __init__(self, key: Hashable, thing: T):
        self.key, self.thing = key, thing

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Keyed) and self.key == other.key
