"""``eiwa schema``: the study file for editors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from eiwa.cli.console import err, print_json


def schema(
    study: Annotated[
        str | None,
        typer.Option("--study", metavar="STUDY.toml", help="A study file, whose own plugin files count too."),
    ] = None,
    part: Annotated[bool, typer.Option("--part", help="Of a file of tables that a design takes from.")] = False,
) -> None:
    """Print the JSON Schema of the study file with every plugin's parameters; editors complete and check by it."""
    from eiwa.core import registry, spec
    from eiwa.core import schema as schemas

    known = registry.load() if study is None else spec.registry_of(spec.read(Path(study)), Path(study))
    for broken in known.broken:
        err().print(f"not in the schema: {broken.provider}: {broken.reason}", style="red", markup=False)
    print_json(schemas.schema(known, part))
