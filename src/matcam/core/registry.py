"""Things that users choose by name: the one list of each kind.

A registry knows names at once and imports what they stand for when it is first asked for, so that the command line can
list its choices without loading JAX.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from typing import Generic, TypeVar

T = TypeVar("T")


class Registry(Mapping[str, T], Generic[T]):
    """Map names to classes or functions, each imported when it is first asked for.

    Attributes:
        homes: place of each by its name, "package.module:attribute".
    """

    def __init__(self, homes: Mapping[str, str]):
        self.homes = dict(homes)

    def __getitem__(self, name: str) -> T:
        module, attribute = self.homes[name].split(":")
        return getattr(import_module(module), attribute)

    def __contains__(self, name: object) -> bool:
        return name in self.homes  # a question after a name imports nothing

    def __iter__(self) -> Iterator[str]:
        return iter(self.homes)

    def __len__(self) -> int:
        return len(self.homes)

    def subset(self, keep: Callable[[str], bool]) -> Registry[T]:
        """Return the registry of the names for which `keep` is true."""
        return Registry({name: home for name, home in self.homes.items() if keep(name)})

    def __repr__(self) -> str:
        return f"Registry({', '.join(self.homes)})"
