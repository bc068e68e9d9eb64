"""Every built-in keeps the contracts that are asked of an outsider's plugin."""

from functools import cache
from pathlib import Path

import pytest

from eiwa import testing
from eiwa.core.errors import SpecError
from eiwa.core.registry import load
from eiwa.testing import samples
from eiwa.testing.dexterity import invariances
from eiwa.testing.subject import of_entry

TABLES = {
    ("arm", "urdf"): [{"file": "studies/devices/touch.urdf"}],
    **{("human", name): [{"samples": 1 << 16}] for name in ("ehem", "ehem_comfort", "ehem_percentile")},
    **{("dexterity", name): [{"rows": "translation"}] for name in ("condition", "isotropy", "smallest_singular_value")},
    ("dexterity", "joint_limits"): [{"K_scaled": 3.0}, {"form": "mean"}],
    ("human", "points"): [{"file": "tests/data/hands.csv"}],
    **{("voxels", store): [{"aggregate": "max"}, {"aggregate": "mean"}] for store in ("auto", "dense", "sparse")},
}
"""Parameters to try a built-in with, where its defaults and examples are not what should be tried; one list entry each."""

PREFERS_DIRECTIONS = {"extended"}
"""Indices that may change when the base is turned."""

FOLDER = Path(__file__).parents[2]
"""Where files that parameters name are looked for."""

BUILT_IN = {key: entry for key, entry in load().entries.items() if entry.provider.startswith("eiwa.plugins.")}
TRIED = [(*key, position) for key in BUILT_IN for position in range(len(TABLES.get(key, [{}])))]
CASES = [(*tried, contract) for tried in TRIED for contract in testing.contracts(tried[0])]


@cache
def subject(kind, name, position):
    """The built-in, built from the table at a position; None when its parameters are not complete."""
    try:
        return of_entry(BUILT_IN[kind, name], TABLES.get((kind, name), [{}])[position], FOLDER)
    except SpecError:
        return None


@pytest.fixture(autouse=True)
def hasty(monkeypatch):
    """Speeds are not what is tested here."""
    monkeypatch.setattr(samples, "SECONDS", 0.0)


def label(value):
    return value.__name__ if callable(value) else str(value)


@pytest.mark.parametrize(("kind", "name", "position"), TRIED)
def test_it_can_be_tried(kind, name, position):
    remedy = f"give its parameters defaults or examples=[...], or add ({kind!r}, {name!r}): [{{...}}] to TABLES"
    assert subject(kind, name, position), f"{kind} {name} has parameters that nothing fills: {remedy}"


@pytest.mark.parametrize(("kind", "name", "position", "contract"), CASES, ids=label)
def test_contract(kind, name, position, contract):
    if subject(kind, name, position) is None:
        pytest.skip("it cannot be tried")
    assert contract(subject(kind, name, position))


def test_tables_are_of_built_ins():
    assert TABLES.keys() <= BUILT_IN.keys()


@pytest.mark.parametrize("name", [name for kind, name in BUILT_IN if kind == "dexterity"])
def test_an_index_does_not_depend_on_where_the_base_stands(name):
    """By default an index is of the arm alone: turning and moving its base changes nothing."""
    changes = invariances(subject("dexterity", name, 0))
    assert changes["moving the base"] <= 1e-9
    assert (changes["turning the base"] <= 1e-9) is (name not in PREFERS_DIRECTIONS)
