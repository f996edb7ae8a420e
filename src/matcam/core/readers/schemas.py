"""Schemas of documents (pydantic)."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from matcam.core.errors import FileFormatError
from matcam.core.readers.texts import first_problem

M = TypeVar("M", bound=BaseModel)


class Strict(BaseModel):
    """Section of a document, without unknown fields or converted types."""

    model_config = ConfigDict(extra="forbid", strict=True)


def validated(schema: type[M], document: Any, where: str | Path, unnamed: Collection[str] = ()) -> M:
    """Check a document by a schema.

    The message of a FileFormatError contains the location `where` of the document, and the field. `unnamed` is
    described in `first_problem`.
    """
    try:
        return schema.model_validate(document)
    except ValidationError as error:
        raise FileFormatError(f"{where}: {first_problem(error, unnamed)}") from None
