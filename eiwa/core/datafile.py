"""A file of data that a plugin's parameters name, found beside the study file and known by its content."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, get_args

from pydantic import BaseModel, PlainSerializer, PlainValidator, ValidationInfo, WithJsonSchema


@dataclass(frozen=True)
class DataFile:
    """``name`` as the study writes it (relative to the study file), ``path`` where it lies, ``digest`` of its bytes."""

    name: str
    path: Path
    digest: str

    def __str__(self) -> str:
        return f"{self.name} sha256:{self.digest}"


def _read(value: Any, info: ValidationInfo) -> DataFile:
    """The file of a name, where the validation context's ``locate`` says.

    A name may end in `` sha256:...``, as a resolved study shows it: the content must then be the same.
    """
    if isinstance(value, DataFile):
        return value
    if not (isinstance(value, str) and value):
        raise ValueError("must be the name of a file, relative to the study file")
    name, _, wanted = value.partition(" sha256:")
    path = (info.context or {}).get("locate", Path)(name)
    try:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
    except OSError as error:
        reason = (error.strerror or "error").lower()
        raise ValueError(f"the file cannot be read ({reason}); looked for {path}") from None
    if wanted and wanted != digest:
        raise ValueError(f"the file has changed: its content is sha256:{digest} now")
    return DataFile(name, path, digest)


FileParameter = Annotated[
    DataFile,
    PlainValidator(_read),
    PlainSerializer(str, return_type=str),
    WithJsonSchema({"type": "string", "description": "A file, relative to the study file."}),
]
"""Type of a plugin's parameter that names a file; its content is part of the study's hash."""


def rebased(model: type[BaseModel], table: dict[str, Any], folder: PurePosixPath) -> dict[str, Any]:
    """A table of that model from a file in another folder: the files that it names are named from the study's folder."""
    files = {name for name, field in model.model_fields.items() if _is_file(field.annotation)}
    return {k: str(folder / v) if k in files and isinstance(v, str) and v else v for k, v in table.items()}


def _is_file(annotation: Any) -> bool:
    return annotation is DataFile or any(_is_file(part) for part in get_args(annotation))
