"""The command line: the only place that prints. Heavy imports wait inside the commands, so that --help is instant."""

from __future__ import annotations

import codecs
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from io import TextIOWrapper

import typer

from eiwa.cli import bench, converge, evaluate, plugins, schema, study

SPELLED = {"±": "+-", "−": "-", "·": "*", "²": "^2", "≤": "<=", "≥": ">=", "…": ".", "─": "-", "━": "-"}
app = typer.Typer(
    name="eiwa",
    help="Which link lengths, base spacing and placement give operators the largest dexterous workspace "
    "where their hands are comfortable?",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.add_typer(study.app, name="study")
app.add_typer(plugins.app, name="plugins")
app.command("evaluate")(evaluate.evaluate)
app.command("converge")(converge.converge)
app.command("verify")(converge.verify)
app.command("bench")(bench.bench)
app.command("schema")(schema.schema)


@app.callback(invoke_without_command=True)
def _version(show: bool = typer.Option(False, "--version", help="Print the version and exit.")) -> None:
    if show:
        from eiwa.core.version import __version__

        print(f"eiwa {__version__}")
        raise typer.Exit


@contextmanager
def ctrl_c_comes_again() -> Iterator[None]:
    """A Ctrl-C that a callback swallows, of which numba's compiler has some, comes again a moment later."""
    before = sys.unraisablehook

    def hook(lost: sys.UnraisableHookArgs) -> None:
        if not issubclass(lost.exc_type, KeyboardInterrupt):
            before(lost)
            return
        again = threading.Timer(0.1, signal.pthread_kill, (threading.main_thread().ident, signal.SIGINT))
        again.daemon = True
        again.start()

    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = before


def _spelled(error: UnicodeError) -> tuple[str, int]:
    """What a terminal that is not told to speak Unicode shows for a character that it lacks."""
    assert isinstance(error, UnicodeEncodeError)
    return "".join(SPELLED.get(c, "?") for c in error.object[error.start : error.end]), error.end


def main() -> None:
    """Run the command line; errors that eiwa raises on purpose end with their message and exit code 2."""
    if sys.platform not in ("linux", "darwin"):
        sys.exit("eiwa runs on Linux and macOS.")
    from eiwa.cli.console import fail
    from eiwa.core.errors import EiwaError

    codecs.register_error("eiwa", _spelled)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="eiwa")
    wanted = os.environ.get("EIWA_THREADS") or "1"
    if not wanted.isdecimal() or int(wanted) < 1:
        fail(EiwaError(f"EIWA_THREADS = {wanted!r}: must be a whole number above 0. Unset it to use all processors."))
    try:
        with ctrl_c_comes_again():
            app()
    except EiwaError as error:
        fail(error)
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except OSError as error:
        if error.filename is None:
            raise
        fail(EiwaError(f"{error.filename}: {error.strerror}. Choose another place, or free this one."))
