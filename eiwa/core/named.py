"""Named designs: other values at some paths, and whole tables, written in the study or taken from another file."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from eiwa.core.datafile import rebased
from eiwa.core.design import PLUGGED, SECTIONS
from eiwa.core.errors import SpecError, finding
from eiwa.core.findings import validated
from eiwa.core.registry import Registry
from eiwa.core.sections import DesignSection
from eiwa.core.tree import Tree, did_you_mean, leaves

REPLACEABLE = tuple(section for section in SECTIONS if section != "metrics")


def named_design(name: str, table: Any, registry: Registry, within: str = "designs") -> DesignSection:
    """A table ``[designs.NAME]`` (or one like it elsewhere), what it takes ``from`` another file written out.

    Raises
    ------
    SpecError
        It says something that no design can.
    """
    path = f"{within}.{name}"
    if within == "designs" and re.fullmatch(r"((trial|leader)\s*)?\d+", name):
        raise SpecError(finding(path, "commands call a trial of the search so.", remedy="Choose another name."))
    if not isinstance(table, dict):
        raise SpecError(finding(path, f"must be a table: write [{path}].", value=table))
    overrides = _tables(f"{path}.from", table["from"], registry) if "from" in table else {}
    overrides |= {key: value for key, value in table.items() if key not in ("from", "published")}
    for key, value in table.items():
        if not (key == "published" or (key in SECTIONS and isinstance(value, dict) and "kind" in value)):
            refuse_unquoted(path, key, value)
    return validated(DesignSection, {"overrides": overrides, "published": table.get("published", {})}, path)


def _tables(path: str, name: Any, registry: Registry) -> Tree:
    """The tables of a file beside the study; files that they name are looked for beside that file."""
    if not (isinstance(name, str) and name):
        raise SpecError(finding(path, "must be the name of a TOML file, relative to the study file.", value=name))
    try:
        tree = tomllib.loads(registry.locate(name).read_text(encoding="utf-8-sig"))
    except OSError as error:
        reason = (error.strerror or "error").lower()
        problem = f"the file cannot be read ({reason}); looked for {registry.locate(name)}."
        raise SpecError(finding(path, problem, value=name)) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SpecError(finding(path, f"is not TOML: {error}.", value=name)) from None
    for section, table in tree.items():
        if section not in REPLACEABLE or not isinstance(table, dict):
            raise SpecError(finding(path, f"{name} has {section!r}{did_you_mean(section, REPLACEABLE)}", value=name))
        known = registry.entries.get((section, str(table.get("kind"))))
        if known is not None:
            tree[section] = rebased(known.plugin.parameters, table, PurePosixPath(Path(name).parent.as_posix()))
    return tree


def refuse_unquoted(table: str, path: str, value: Any) -> None:
    """A path without quotes is a table in TOML; tell which quotes are missing."""
    if isinstance(value, dict) and "." not in path:
        whole, inner = next(iter(leaves(value, path)))
        shown = inner if isinstance(inner, int | float) else repr(inner)
        remedy = f'Quote the whole path: "{whole}" = {shown}.'
        if path in PLUGGED:
            remedy += f" Or write the whole table, with its kind: {path} = {{ kind = ... }}."
        raise SpecError(finding(f"{table}.{path}", "values stand at quoted paths here.", remedy=remedy))


def parted(overrides: Mapping[str, Any]) -> tuple[Tree, dict[str, Any]]:
    """Whole tables, and values at paths, which go into what the tables say."""
    tables = {path: value for path, value in overrides.items() if isinstance(value, dict) and "." not in path}
    return tables, {path: value for path, value in overrides.items() if path not in tables}


def pinned(value: Any, resolved: Any) -> Any:
    """The same with every file's name as the resolved study shows it: with the hash of its content."""
    if isinstance(value, dict):
        known = resolved if isinstance(resolved, dict) else {}
        return {key: pinned(entry, known.get(key)) for key, entry in value.items()}
    is_file = isinstance(value, str) and isinstance(resolved, str) and resolved.startswith(f"{value} sha256:")
    return resolved if is_file else value
