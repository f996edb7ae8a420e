"""A remark: what a reader should know of a result, with a code that programs can match."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple


class Remark(NamedTuple):
    """Say one thing that a reader should know of a result.

    Attributes:
        code: lower-case words joined by hyphens ("outliers", "camera-not-determined"): stable between versions.
        text: one line in plain words.

    Example:
        >>> print(Remark("clipped", "3 pixels are clipped and were left out"))
        3 pixels are clipped and were left out
    """

    code: str
    text: str

    def __str__(self) -> str:
        return self.text

    def to_dict(self) -> dict[str, str]:
        """Return the remark as a JSON object.

        Returns:
            Both fields by name.
        """
        return {"code": self.code, "text": self.text}


def texts(remarks: Iterable[Remark]) -> list[str]:
    """Return the remarks' texts.

    Args:
        remarks: any number of them.

    Returns:
        One line each, in the same order.
    """
    return [remark.text for remark in remarks]
