"""A study and the results that it has so far."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eiwa.cli.console import err

if TYPE_CHECKING:
    from eiwa.core.spec import StudySpec
    from eiwa.study.store import Store


def results(study: str, runs: str, settings: Mapping[str, Any]) -> tuple[StudySpec, Store]:
    """The study and its folder; says on stderr when the results are of another version of the study file.

    Raises
    ------
    StoreError
        There are no results yet.
    """
    from eiwa.core.spec import load
    from eiwa.study.store import Store

    spec = load(Path(study), settings)
    store = Store(Path(runs) / spec.study.name)
    store.require(study)
    tell_changes(spec, store)
    return spec, store


def tell_changes(spec: StudySpec, store: Store) -> None:
    """Say on stderr when the results are of another version of the study file."""
    if changed := store.changes(spec):
        console = err()
        console.print(
            "These results are of another version of the study file; their numbers would differ:", style="yellow"
        )
        for line in changed[:8]:
            console.print(f"  {line}", markup=False, soft_wrap=True)
