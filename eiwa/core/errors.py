"""Every error that eiwa raises on purpose.

::

    EiwaError
    ├── SpecError       a study file says something that cannot be: path, value, what is allowed, remedy
    ├── SingularArm     no posture of the arm has any dexterity in the rows that the index looks at
    ├── PluginError     a plugin is broken, missing, or clashes with another
    ├── StoreError      a study's folder cannot be read, written, or continued
    └── ExecutionError  workers cannot be started or reached, or are not like this process
"""

from __future__ import annotations

import re
import sys
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any


class EiwaError(Exception):
    """Base class; the command line prints its message and exits with code 2."""


class SpecError(EiwaError):
    """One or more findings in a study file.

    Parameters
    ----------
    findings
        One finished sentence each: TOML path, value, what is allowed, remedy (see :func:`finding`).
    """

    def __init__(self, *findings: str) -> None:
        self.findings: Sequence[str] = findings
        super().__init__("\n".join(findings))


class SingularArm(EiwaError):
    """The arm's Jacobian is rank-deficient in the wanted rows at every posture."""


class PluginError(EiwaError):
    """A plugin cannot be loaded or used."""


class StoreError(EiwaError):
    """A study's folder on disk cannot be used as asked."""


class ExecutionError(EiwaError):
    """Evaluations cannot be handed to other processes."""


@contextmanager
def blaming(part: object) -> Iterator[None]:
    """Turn whatever a plugin's part raises into a PluginError that names it."""
    try:
        yield
    except EiwaError:
        raise
    # A plugin may raise anything; its user needs to know which one it was.
    except Exception as error:
        file = getattr(sys.modules.get(_kind(part).__module__), "__file__", None)
        raised = f"{type(error).__name__}: {error}{line_in(file, error)}"
        raise PluginError(f"{name_of(part)} raised {raised}") from error


def name_of(part: object) -> str:
    """A function's or an object's class, and the file or module it comes from."""
    kind = _kind(part)
    module = sys.modules.get(kind.__module__)
    local = kind.__module__.startswith("eiwa_local_") and module is not None
    where = Path(str(module.__file__)).name if local and module is not None else kind.__module__
    return f"{getattr(kind, '__qualname__', kind)} ({where})"


def _kind(part: object) -> Any:
    return part if hasattr(part, "__qualname__") else type(part)


def line_in(file: str | None, error: BaseException) -> str:
    """' (line 12)': the innermost line of a file on the way to an error; empty where it is on none."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    return f" (line {lines[-1]})" if lines else ""


_NOTHING = object()


def finding(path: str, problem: str, *, value: object = _NOTHING, remedy: str = "") -> str:
    """One line for a :class:`SpecError`: where, what stands there, what is allowed, what to do."""
    shown = "" if value is _NOTHING else f" = {_short(value)}"
    return f"{path}{shown}: {problem}" + (f" {remedy}" if remedy else "")


def _short(value: object, width: int = 60) -> str:
    text = re.sub(r"(://[^/@:]*):[^/@]*@", r"\1:***@", repr(value))  # no password is shown
    return text if len(text) <= width else text[: width - 3] + "..."
