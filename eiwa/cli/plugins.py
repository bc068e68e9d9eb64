"""``eiwa plugins``: what a study can name, and the kit for writing more of it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eiwa.cli.console import AsJson, err, listen_to_log, out, print_json, settings

if TYPE_CHECKING:
    from eiwa.core.registry import Entry, Registry
    from eiwa.core.tree import Tree

app = typer.Typer(help="Look at plugins, check one, or begin a new one.", no_args_is_help=True)

GIVE = "Give parameters by --set KEY=VALUE or --study STUDY.toml; defaults, or quantity(..., examples=[...]), make it unneeded."

OfStudy = Annotated[
    str | None, typer.Option("--study", metavar="STUDY.toml", help="A study file, whose own plugin files count too.")
]
Kind = Annotated[
    str | None, typer.Option("--kind", help="arm, dexterity, human, voxels or metrics, where a name is in several.")
]


@app.command("list")
def list_(study: OfStudy = None, as_json: AsJson = False) -> None:
    """List every plugin, and installed ones that could not be loaded."""
    from eiwa.core.registry import KINDS

    registry = _registry(study)[0]
    entries = [entry for kind in KINDS for entry in registry.of_kind(kind)]
    if as_json:
        rows = [
            {
                "kind": e.kind,
                "name": e.plugin.name,
                "provider": e.provider,
                "version": e.version,
                "summary": e.plugin.summary,
            }
            for e in entries
        ]
        print_json({"plugins": rows, "broken": [{"provider": b.provider, "reason": b.reason} for b in registry.broken]})
        return
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("kind")
    table.add_column("name", style="cyan", no_wrap=True)
    table.add_column("what it is")
    table.add_column("from", style="dim")
    for e in entries:
        table.add_row(e.kind, e.plugin.name, unwrapped(e.plugin.summary), _origin(e))
    console = out()
    console.print(table)
    for b in registry.broken:
        console.print(f"not loaded: {b.provider}: {b.reason}", style="red", markup=False)


@app.command("show")
def show(
    target: Annotated[str, typer.Argument(metavar="NAME", help="A plugin's name, or a plugin file.")],
    kind: Kind = None,
    study: OfStudy = None,
    as_json: AsJson = False,
) -> None:
    """Show every parameter of a plugin: type, range, default, unit, meaning, source."""
    from eiwa.cli import sheets
    from eiwa.core.description import tables

    entries = _entries(_registry(study)[0], target, kind)
    if as_json:
        print_json({"plugins": [_described(entry) for entry in entries]})
        return
    console = out()
    for entry in entries:
        console.print(f"{entry.kind} {entry.plugin.name}, from {_origin(entry)}", style="bold", markup=False)
        whole, *inner = tables(entry.plugin.parameters)
        for part in (whole, *inner):
            text = unwrapped(part.text if part is whole else f"Each {part.name}: {part.text}")
            console.print(text, markup=False)
            if part.keys:
                console.print(sheets.parameters(part.keys))
        if entry.plugin.numbers:
            console.print(sheets.numbers(entry.plugin.numbers))


@app.command("check")
def check(
    target: Annotated[str, typer.Argument(metavar="FILE|NAME", help="A plugin file, or a plugin's name.")],
    kind: Kind = None,
    name: Annotated[str | None, typer.Option("--name", help="One plugin of a file that holds several.")] = None,
    study: Annotated[
        str | None,
        typer.Option("--study", metavar="STUDY.toml", help="Take the plugin's table from this study file."),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Put a value at a key of the plugin's table; repeatable."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Run eiwa's contract tests on a plugin, and explain each failure; exit code 1 when one fails.

    Parameters that --study and --set do not give are taken from the plugin's defaults and examples.
    """
    from eiwa import testing
    from eiwa.core.errors import SpecError
    from eiwa.core.tree import replaced
    from eiwa.testing.subject import chosen, of_entry, starting_values

    listen_to_log()
    registry, tree = _registry(study)
    found = _entries(registry, target, kind)
    entries = chosen(found, kind, name)
    if not entries or (len(entries) > 1 and (set_ or study)):
        held = ", ".join(f"{e.kind} {e.plugin.name}" for e in found)
        raise SpecError(f"{target}: holds {held}. Choose one by --kind and --name.")
    subjects = []
    for entry in entries:
        written = _table(tree, entry, study) if study else {}
        table = replaced(written, settings(set_), starting_values(entry.plugin.parameters))
        try:
            subjects.append(of_entry(entry, table, Path(study or "").parent))
        except SpecError as error:
            lacking = any("is required" in line for line in error.findings)
            raise SpecError(*error.findings, *([GIVE] if lacking else [])) from None
    with err().status("Checking ..."):
        reports = [(entry, subject, testing.check(subject)) for entry, subject in zip(entries, subjects, strict=True)]
    passed = all(result.state != "failed" for _, _, results in reports for result in results)
    if as_json:
        checked = [
            {
                "kind": subject.kind,
                "name": subject.plugin.name,
                "provider": entry.provider,
                "parameters": subject.parameters.model_dump(mode="json"),
                "results": [vars(result) for result in results],
            }
            for entry, subject, results in reports
        ]
        print_json({"passed": passed, "plugins": checked})
    else:
        from eiwa.cli import sheets

        for entry, subject, results in reports:
            out().print(sheets.contracts(f"{subject}, from {_origin(entry)}", subject.parameters, results))
    if not passed:
        sys.exit(1)


@app.command("new")
def new(
    kind: Annotated[str, typer.Argument(metavar="KIND", help="arm, dexterity, human, voxels or metrics.")],
    name: Annotated[str, typer.Argument(metavar="NAME", help="What studies will call it.")],
    package: Annotated[bool, typer.Option("--package", help="A folder that pip installs, with tests.")] = False,
    with_study: Annotated[bool, typer.Option("--with-study", help="Also a small study that uses it.")] = False,
) -> None:
    """Write a working plugin to begin from: one file, or a package; nothing is overwritten."""
    from eiwa.cli.scaffold import new as write

    written = write(kind, name, Path(), package=package, study=with_study)
    console = out()
    console.print(f"Wrote {', '.join(map(str, written))}.", markup=False)
    console.print("Next:")
    source = name if package else f"{name}.py"
    steps = [*([f"pip install -e {name}"] if package else []), f"eiwa plugins check {source}"]
    steps += [f"eiwa study run {written[-1]}"] if with_study else []
    for step in steps:
        console.print(f"  {step}", markup=False)


def _registry(study: str | None) -> tuple[Registry, Tree]:
    """What a study file can name, and the file as written; without one, what any study can."""
    from eiwa.core import registry, spec

    if study is None:
        return registry.load(), {}
    tree = spec.read(Path(study))
    return spec.registry_of(tree, Path(study)), tree


def _entries(registry: Registry, target: str, kind: str | None) -> list[Entry]:
    from eiwa.core.errors import SpecError
    from eiwa.testing.subject import chosen, matching

    found = matching(registry, target)
    if not (entries := chosen(found, kind, None)):
        raise SpecError(f"{target}: there is no {kind} of this name, but: {', '.join(e.kind for e in found)}.")
    return entries


def _table(tree: Tree, entry: Entry, study: str) -> dict[str, Any]:
    """The plugin's own keys of its table in a study file.

    Raises
    ------
    SpecError
        The study has no table of this plugin.
    """
    from eiwa.core.design import DEFAULT_KINDS, OWN
    from eiwa.core.errors import SpecError

    section, name = entry.kind, entry.plugin.name
    table = tree.get(section, {})
    if section == "metrics":
        table = {"kind": name, **table[name]} if isinstance(table, dict) and isinstance(table.get(name), dict) else None
    if not isinstance(table, dict) or table.get("kind", DEFAULT_KINDS.get(section)) != name:
        where = f"[metrics.{name}]" if section == "metrics" else f'[{section}] with kind = "{name}"'
        raise SpecError(f"{study}: has no {where}. Give another study file, or parameters by --set.")
    own = OWN[section].model_fields if section in OWN else {}
    return {
        k: v for k, v in table.items() if k != "kind" and (k not in own or k in entry.plugin.parameters.model_fields)
    }


def unwrapped(text: str) -> str:
    """A docstring for the screen: a line per paragraph, without its literals' marks."""
    paragraphs = text.replace("``", "").split("\n\n")
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)


def _origin(entry: Entry) -> str:
    return "eiwa" if entry.provider.startswith("eiwa.plugins.") else f"{entry.provider} {entry.version}"


def _described(entry: Entry) -> dict[str, Any]:
    return {
        "kind": entry.kind,
        "name": entry.plugin.name,
        "provider": entry.provider,
        "version": entry.version,
        "summary": entry.plugin.summary,
        "parameters": entry.plugin.parameters.model_json_schema(),
        "numbers": [{**vars(n), "low": _finite(n.low), "high": _finite(n.high)} for n in entry.plugin.numbers],
    }


def _finite(bound: float) -> float | None:
    return bound if abs(bound) != float("inf") else None
