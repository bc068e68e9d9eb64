"""Tables about plugins, at most 80 columns wide."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rich import box
from rich.table import Table
from rich.text import Text

from eiwa.core.description import Key, toml

if TYPE_CHECKING:
    from eiwa.core.hookspecs import Number, Parameters
    from eiwa.testing import Result

STYLES = {"passed": "green", "failed": "bold red", "not applicable": "dim", "not run": "dim"}
MOST = 240
"""Characters of parameters that are shown."""
MARKS = {"passed": "ok", "failed": "FAILED", "not applicable": "-", "not run": "not run"}


def parameters(keys: Sequence[Key]) -> Table:
    """What may be written at each key."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    table.add_column("key", style="cyan", no_wrap=True)
    table.add_column("type", max_width=20, overflow="fold")
    table.add_column("default", max_width=17, overflow="fold")
    table.add_column("unit")
    table.add_column("what")
    for key in keys:
        what = f"{key.what} Source: {key.source}." if key.source else key.what
        table.add_row(*(Text(text) for text in (key.name, key.type, key.default, key.unit, what)))
    return table


def numbers(declared: Sequence[Number]) -> Table:
    """What a metric yields."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    for head in ("number", "unit", "between", "what"):
        table.add_column(head, style="cyan" if head == "number" else None)
    for n in declared:
        table.add_row(*(Text(text) for text in (n.name, n.unit, f"{n.low:g} and {n.high:g}", n.description)))
    return table


def contracts(title: str, parameters: Parameters, results: Sequence[Result]) -> Table:
    """How each contract went; a failure with everything there is to know."""
    written = parameters.model_dump(mode="json", exclude_unset=True)
    given = ", ".join(f"{key} = {toml(value)}" for key, value in written.items())
    given = given if len(given) <= MOST else f"{given[: MOST - 3]}..."
    counts = Counter(result.state for result in results)
    table = Table(
        title=Text(f"{title}\n{given}" if given else title, "bold"),
        title_justify="left",
        caption=Text(", ".join(f"{count} {state}" for state, count in counts.items()), "bold"),
        caption_justify="left",
        box=None,
        show_header=False,
        pad_edge=False,
    )
    table.add_column("state", no_wrap=True)
    table.add_column("what")
    for result in results:
        table.add_row(Text(MARKS[result.state], STYLES[result.state]), _said(result))
    return table


def _said(result: Result) -> Any:
    if result.state != "failed":
        return Text.assemble(result.contract, (f": {result.said}", "dim"))
    return Text.assemble((f"{result.contract}\n", "bold"), f"{result.promise}\n{result.said}")
