"""The gantry keeps eiwa's contracts: pytest docs/examples/test_gantry.py"""

from pathlib import Path

import pytest

from eiwa import testing

GANTRY = testing.subject(Path(__file__).with_name("gantry.py"), {"travel": [0.3, 0.2, 0.2]})


@pytest.mark.parametrize("contract", testing.contracts("arm"))
def test_contract(contract):
    contract(GANTRY)
