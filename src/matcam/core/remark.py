"""Remarks on results, with a code that programs can match."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple


class Remark(NamedTuple):
    """Remark on a result.

    Attributes:
        code: lower-case words joined by hyphens, such as "camera-not-determined". Codes do not change between versions.
        text: remark for the user, one line.

    Example:
        >>> print(Remark("clipped", "3 pixels are clipped and were left out"))
        3 pixels are clipped and were left out
    """

    code: str
    text: str

    def __str__(self) -> str:
        return self.text

    def about(self, subject: str) -> Remark:
        """Prefix the text with the name of the subject.

        Args:
            subject: name of an image or channel.
        """
        return Remark(self.code, f"{subject}: {self.text}")

    def to_dict(self) -> dict[str, str]:
        """Return the remark as a JSON object.

        Returns:
            {"code": code, "text": text}.
        """
        return {"code": self.code, "text": self.text}


def some_of(names: Iterable[str], most: int = 6) -> str:
    """List names on one line, shortened if there are many.

    Args:
        names: the names.
        most: largest number of names in the result, no unit. Default: 6.

    Returns:
        Text such as "a, b and 3 more", or "a, b" if there are at most `most` names.

    Example:
        >>> some_of(["a.tif", "b.tif", "c.tif", "d.tif"], most=2)
        'a.tif, b.tif and 2 more'
    """
    every = list(names)
    more = f" and {len(every) - most} more" if len(every) > most else ""
    return ", ".join(every[:most]) + more


def gathered(remarks: Iterable[tuple[str, Remark]]) -> list[Remark]:
    """Combine remarks with the same code on many objects.

    If more than three remarks have the same code, only the first one is kept. The names of the other objects are appended
    to its text.

    Args:
        remarks: pairs of the name of an object and a remark on this object.

    Returns:
        The remarks, grouped by code, in the order in which the codes first occur.

    Example:
        >>> for one in gathered([(f"L{k}", Remark("dark", f"L{k}: no light")) for k in range(1, 6)]):
        ...     print(one)
        L1: no light; likewise L2, L3, L4, L5
    """
    by_code: dict[str, list[tuple[str, Remark]]] = {}
    for name, remark in remarks:
        by_code.setdefault(remark.code, []).append((name, remark))
    found = []
    for code, pairs in by_code.items():
        if len(pairs) <= 3:
            found += [remark for _, remark in pairs]
        else:
            found.append(Remark(code, f"{pairs[0][1]}; likewise {some_of(name for name, _ in pairs[1:])}"))
    return found


def texts(remarks: Iterable[Remark]) -> list[str]:
    """Return the text of each remark.

    Args:
        remarks: any number of remarks.

    Returns:
        The texts in the order of the remarks.
    """
    return [remark.text for remark in remarks]


def to_attribute(remarks: Iterable[Remark]) -> str:
    """Join remarks into one string for an attribute of a file.

    Args:
        remarks: any number of remarks.

    Returns:
        One line for each remark, "code: text".

    Example:
        >>> to_attribute([Remark("clipped", "3 pixels are clipped; they were left out")])
        'clipped: 3 pixels are clipped; they were left out'
    """
    return "\n".join(f"{remark.code}: {remark.text}" for remark in remarks)


def from_attribute(attribute: str) -> tuple[Remark, ...]:
    """Parse the remarks in a string of `to_attribute`.

    Args:
        attribute: one line for each remark, "code: text".

    Returns:
        The remarks in the order of the lines.

    Example:
        >>> from_attribute("clipped: 3 pixels are clipped; they were left out")[0].code
        'clipped'
    """
    return tuple(Remark(*line.split(": ", 1)) for line in attribute.splitlines())
