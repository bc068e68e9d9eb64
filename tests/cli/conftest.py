"""The command line in this process: quick, with what it printed and its exit code."""

import logging
import sys
from dataclasses import dataclass

import pytest

from eiwa.cli import main
from tests.study.conftest import unflushed  # noqa: F401 (a fixture for every test here)


@dataclass(frozen=True)
class Said:
    """What a command printed, and its exit code."""

    code: int
    out: str
    err: str


@pytest.fixture
def cli(capsys, monkeypatch):
    """``eiwa ...`` as a function."""
    logger = logging.getLogger("eiwa")
    handlers, propagate = list(logger.handlers), logger.propagate

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["eiwa", *map(str, arguments)])
        capsys.readouterr()
        try:
            main()
            code = 0
        except SystemExit as end:
            code = end.code or 0
        captured = capsys.readouterr()
        return Said(code, captured.out, captured.err)

    yield call
    logger.handlers[:], logger.propagate = handlers, propagate
