"""A study file as a tree of plain values, and paths into it (``arm.joints.upper.a``, ``layout.offset.1``)."""

from __future__ import annotations

import copy
import difflib
from collections.abc import Iterable, Mapping
from typing import Any

from eiwa.core.errors import SpecError, finding

Tree = dict[str, Any]


def lookup(tree: Any, path: str) -> Any:
    """The value at a path.

    Raises
    ------
    SpecError
        A step of the path does not exist.
    """
    node, walked = tree, ""
    for step in path.split("."):
        node = node[_key(node, step, path, walked)]
        walked = f"{walked}.{step}" if walked else step
    return node


def exists(tree: Any, path: str) -> bool:
    """Whether every step of the path exists."""
    try:
        lookup(tree, path)
    except SpecError:
        return False
    return True


def replaced(tree: Tree, values: Mapping[str, Any], defaults: Tree | None = None) -> Tree:
    """A copy of the tree with other values at some paths.

    Tables and lists that a path passes through and the tree does not write out are taken from ``defaults`` (without
    them, a missing table at the top is added); a last step that is not there yet is added.

    Raises
    ------
    SpecError
        A path passes through something that neither has.
    """
    result = copy.deepcopy(tree)
    for path, value in values.items():
        *parents, last = path.split(".")
        node: Any = result
        walked = ""
        for step in parents:
            if defaults is None and not walked:
                node.setdefault(step, {})
            elif isinstance(node, dict) and step not in node:
                known = _at(defaults or {}, walked)
                if isinstance(known, dict) and isinstance(known.get(step), dict | list):
                    node[step] = {} if isinstance(known[step], dict) else copy.deepcopy(known[step])
            node = node[_key(node, step, path, walked)]
            walked = f"{walked}.{step}" if walked else step
        if isinstance(node, dict):
            node[last] = copy.deepcopy(value)
        else:
            node[_key(node, last, path, walked)] = copy.deepcopy(value)
    return result


def _at(tree: Tree, path: str) -> Any:
    return (lookup(tree, path) if exists(tree, path) else None) if path else tree


def _key(node: Any, step: str, path: str, walked: str) -> Any:
    """Key or index of one step: a table's key, a list item's ``name``, or a number's position."""
    if isinstance(node, dict) and step in node:
        return step
    if isinstance(node, list):
        names = [item.get("name") if isinstance(item, dict) else None for item in node]
        if step in names:
            return names.index(step)
        if step.isdigit() and int(step) < len(node) and not any(names):
            return int(step)
        known = [n for n in names if n] or [str(i) for i in range(len(node))]
    else:
        known = list(node) if isinstance(node, dict) else []
    where = f"{walked} has" if walked else "the study file has"
    raise SpecError(finding(path, f"{where} no {step!r}{did_you_mean(step, known)}"))


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """'; did you mean X? Known: ...' with the nearest known word first."""
    words = sorted({str(k) for k in known})
    folded = {w.casefold(): w for w in words}
    near = difflib.get_close_matches(word.casefold(), folded, n=1, cutoff=0.5)
    hint = f"; did you mean {folded[near[0]]!r}?" if near else "."
    return f"{hint} Known: {', '.join(words)}." if words else hint


def leaves(tree: Any, prefix: str = "") -> Iterable[tuple[str, Any]]:
    """All (path, value) pairs of a tree; list items by their name or position."""
    if isinstance(tree, dict) and tree:
        items: Iterable[tuple[str, Any]] = tree.items()
    elif isinstance(tree, list) and any(isinstance(item, dict) for item in tree):
        items = (
            (item.get("name") or str(i) if isinstance(item, dict) else str(i), item) for i, item in enumerate(tree)
        )
    else:
        yield prefix, tree
        return
    for key, value in items:
        yield from leaves(value, f"{prefix}.{key}" if prefix else str(key))
