"""Speeds are not what is tested here."""

import pytest

from eiwa.testing import samples


@pytest.fixture(autouse=True)
def hasty(monkeypatch):
    """A speed from one call."""
    monkeypatch.setattr(samples, "SECONDS", 0.0)
