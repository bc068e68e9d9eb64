"""``eiwa plugins``: what a study can name."""

from __future__ import annotations

import typer

from eiwa.cli.console import AsJson, out, print_json

app = typer.Typer(help="Look at the plugins that a study can name.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Keep ``list`` a subcommand while it is the only one."""


@app.command("list")
def list_(as_json: AsJson = False) -> None:
    """List every plugin, and installed ones that could not be loaded."""
    from eiwa.core.registry import KINDS, load

    registry = load()
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
        print_json(
            {
                "plugins": rows,
                "broken": [{"provider": b.provider, "reason": b.reason} for b in registry.broken],
            }
        )
        return
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("kind")
    table.add_column("name", style="cyan", no_wrap=True)
    table.add_column("what it is")
    table.add_column("from", style="dim")
    for e in entries:
        provider = "eiwa" if e.provider.startswith("eiwa.plugins.") else f"{e.provider} {e.version}"
        table.add_row(e.kind, e.plugin.name, e.plugin.summary, provider)
    console = out()
    console.print(table)
    for b in registry.broken:
        console.print(f"not loaded: {b.provider}: {b.reason}", style="red", markup=False)
