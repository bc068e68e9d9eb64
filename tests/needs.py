"""What some tests need of the machine: skipped with the reason without it, failed where ``EIWA_REQUIRE`` names it."""

import os

import pytest


def need(name, found, reason):
    """Go on with what was found; ``EIWA_REQUIRE=postgres,chromium`` (as in .ci/run) makes a missing one a failure."""
    if not found:
        required = name in os.environ.get("EIWA_REQUIRE", "").split(",")
        (pytest.fail if required else pytest.skip)(reason)
    return found
