"""What every command shares: where text goes, how values are read, how errors look."""

from __future__ import annotations

import json
import logging
import os
import shutil
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

from eiwa.core.errors import EiwaError, SpecError

StudyFile = Annotated[str, typer.Argument(metavar="STUDY.toml", help="The study file.")]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="PATH=VALUE", help="Put another value at a path of the study file; repeatable."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout, everything else on stderr.")]
Runs = Annotated[str, typer.Option("--runs", metavar="DIR", help="Where the folders of studies are.")]


def called() -> str:
    """What to write for ``eiwa`` to run it again: its path, where the shell would not find it."""
    program = sys.argv[0]
    if os.path.basename(program) != "eiwa" or shutil.which("eiwa"):
        return "eiwa"
    return min(os.path.relpath(program), program, key=len)


def pip() -> str:
    """What to write for ``pip`` to install into this environment, whether or not it is activated."""
    beside = os.path.join(os.path.dirname(sys.executable), "pip")
    if shutil.which("pip") == beside or not os.path.exists(beside):
        return "pip"
    return min(os.path.relpath(beside), beside, key=len)


def settings(pairs: list[str] | None) -> dict[str, Any]:
    """``--set`` options as paths and values; a value is read as TOML, and as a string where it is not."""
    values = {}
    for pair in pairs or []:
        path, equals, text = (part.strip() for part in pair.partition("="))
        if not equals or not path:
            raise SpecError(f"--set {pair}: write PATH=VALUE, as in --set layout.spacing=0.25")
        try:
            values[path] = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            values[path] = text
    return values


def out() -> Any:
    """The console for results."""
    from rich.console import Console

    return Console(highlight=False, soft_wrap=False, width=None if sys.stdout.isatty() else 80)


def err() -> Any:
    """The console for progress and messages."""
    from rich.console import Console

    return Console(stderr=True, highlight=False, width=None if sys.stderr.isatty() else 80)


def require_drawable(figure: str | None) -> None:
    """Refuse, before any work, a ``--figure`` that could not be drawn."""
    if figure:
        from eiwa.report.figure import require

        require(Path(figure))


def print_json(value: Any) -> None:
    """One JSON object on stdout."""
    print(json.dumps(value, indent=1, default=str, allow_nan=False))


@contextmanager
def resumable() -> Iterator[None]:
    """End an interrupted run with what its user needs to know, and exit code 130."""
    try:
        yield
    except KeyboardInterrupt:
        err().print("Stopped. Finished trials are kept; run the same command to continue.")
        raise typer.Exit(130) from None


def fail(error: EiwaError) -> NoReturn:
    """Print an error's message and leave with exit code 2."""
    console = err()
    findings = error.findings if isinstance(error, SpecError) else str(error).split("\n")
    for line in findings:
        line = line.replace("pip install", f"{pip()} install")
        console.print(line, style="red", markup=False, soft_wrap=True)
    sys.exit(2)


class _Once(logging.Handler):
    """Says once that a kernel is being compiled."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self._said: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        text = record.getMessage()
        if text not in self._said:
            self._said.add(text)
            err().print(text[0].upper() + text[1:] + ".", style="dim", markup=False)


def listen_to_log() -> None:
    """Show eiwa's own log messages on stderr."""
    logger = logging.getLogger("eiwa")
    logger.handlers[:] = [_Once()]
    logger.propagate = False
