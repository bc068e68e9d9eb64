"""Human models by the name that a study writes, on grids of their own."""

from functools import lru_cache
from pathlib import Path

import numpy as np

from eiwa.core.evaluation import ergonomic_grid, field_stream
from eiwa.core.findings import validated
from eiwa.core.interfaces import Operator
from eiwa.core.registry import load
from eiwa.core.workspace import Grid


@lru_cache(maxsize=1)
def registry():
    return load()


def human(kind, folder=Path(), **parameters):
    """The model of a [human] table, validated as a study's."""
    plugin = registry().find("human", kind, "human.kind")
    return plugin.build(validated(plugin.parameters, parameters, "human", {"locate": folder.joinpath}))


def own_grid(model, r, operator=None):
    return ergonomic_grid([model.bounds(operator or Operator())], r)


def wider(grid, cells=3):
    return Grid(grid.r, tuple(o - cells for o in grid.origin), tuple(n + 2 * cells for n in grid.shape))


def field(model, grid, operator=None, replicate=0):
    return model.field(grid, operator or Operator(), field_stream(1, replicate))


def litres(E, r):
    """Volume of the cells with E > 0."""
    return np.count_nonzero(E) * r**3 * 1000
