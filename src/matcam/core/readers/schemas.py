"""Validation of documents by schemas (pydantic)."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from matcam.core.errors import FileFormatError
from matcam.core.readers.texts import first_problem

M = TypeVar("M", bound=BaseModel)


class Strict(BaseModel):
    """Base of schemas that allow no unknown fields and convert no types."""

    model_config = ConfigDict(extra="forbid", strict=True)


def validated(schema: type[M], document: Any, where: str | Path, unnamed: Collection[str] = ()) -> M:
    """Check a document by a schema.

    A FileFormatError is raised if the document is invalid. Its message contains `where`, the location of the document, and
    the name of the field. `unnamed` is the argument of `first_problem`.
    """
    try:
        return schema.model_validate(document)
    except ValidationError as error:
        raise FileFormatError(f"{where}: {first_problem(error, unnamed)}") from None
