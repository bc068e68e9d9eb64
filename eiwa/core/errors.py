"""Every error that eiwa raises on purpose.

::

    EiwaError
    ├── SpecError       a study file says something that cannot be: path, value, what is allowed, remedy
    ├── SingularArm     no posture of the arm has any dexterity in the rows that the index looks at
    ├── PluginError     a plugin is broken, missing, or clashes with another
    └── StoreError      a study's folder cannot be read, written, or continued
"""

from __future__ import annotations

from collections.abc import Sequence


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


_NOTHING = object()


def finding(path: str, problem: str, *, value: object = _NOTHING, remedy: str = "") -> str:
    """One line for a :class:`SpecError`: where, what stands there, what is allowed, what to do."""
    shown = "" if value is _NOTHING else f" = {_short(value)}"
    return f"{path}{shown}: {problem}" + (f" {remedy}" if remedy else "")


def _short(value: object, width: int = 60) -> str:
    text = repr(value)
    return text if len(text) <= width else text[: width - 3] + "..."
