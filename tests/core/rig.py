"""Parts whose numbers follow by hand: an index that is 1 everywhere, hands in a box, setups made of them."""

import numpy as np

from eiwa.core.dexterity import Family
from eiwa.core.elites import refine
from eiwa.core.evaluation import Layout, Setup, ergonomic_grid, field_stream, measure
from eiwa.core.filling import Sampling, fill
from eiwa.core.interfaces import DexterityIndex, ErgonomicField, HumanModel, Operator, TracedIndex
from eiwa.core.sampling import Stream
from eiwa.plugins.dexterity.yoshikawa import Yoshikawa
from eiwa.plugins.voxels.stores import Dense
from tests import arms

BACKENDS = {"max": Dense("max"), "mean": Dense("mean")}
ALL_ROWS = tuple(range(6))
PAPER_INDEX = Yoshikawa(K=None, K_scaled=3.0, rows=ALL_ROWS)
"""A factor of 0.95 at mid-range."""


class One(TracedIndex):
    """1 at every posture."""

    structure = "one"

    def columns(self, arm, p):
        return 1.0


class ArrayIndex(DexterityIndex):
    """An index from a function of postures, in plain NumPy."""

    def __init__(self, function):
        self.function = function

    def values(self, postures, prepared):
        return self.function(postures)


class Box(HumanModel):
    """The right hand is comfortable in a box, the left one in its mirror image."""

    def __init__(self, low, high, comfort=0.5):
        self.low, self.high, self.comfort = np.array(low, float), np.array(high, float), comfort

    def bounds(self, operator):
        wide = max(-self.low[0], self.high[0])
        raised = np.array([0.0, 0.0, operator.armrest])
        return np.array([[-wide, *self.low[1:]], [wide, *self.high[1:]]]) + raised

    def field(self, grid, operator, stream):
        centres = np.stack(np.meshgrid(*(grid.centres(k) for k in range(3)), indexing="ij"), axis=-1)
        centres -= [0, 0, operator.armrest]
        right = ((centres > self.low) & (centres < self.high)).all(axis=-1) * self.comfort
        return ErgonomicField(right, right[::-1])


def setup(arm=None, index=PAPER_INDEX, layout=None, human=None, **changes):
    """The paper's arm between two hands, or whatever is changed."""
    options = {
        "human_key": "box",
        "index_key": "index",
        "normaliser": None,
        "threshold": 0.0,
        "operator": Operator(),
        "backend": BACKENDS["max"],
        "r": 0.03125,
        "sampling": Sampling(1 << 16),
        "estimator": "plain",
        "seed": 1,
        "metrics": {},
    }
    return Setup(
        arm=arm or arms.paper(limits=(-2.0, 2.0)),
        index=index,
        layout=layout or Layout(0.25, (0.0, 0.5, 0.0), (0.0, 0.0, -np.pi / 2)),
        human=human or Box((0.0, 0.25, -0.125), (0.25, 0.5, 0.125)),
        **(options | changes),
    )


def measured(design, replicates=1):
    """One design on its own human's grid."""
    grid = ergonomic_grid([design.human.bounds(design.operator)], design.r)
    fields = [design.human.field(grid, design.operator, field_stream(design.seed, k)) for k in range(replicates)]
    return measure([design], grid, [fields])[0]


def refine_one(dexterity, targets, weights, stream, amount):
    """What ``refine`` finds for a family of one and one field of weights: grids, refinement."""
    ((filled, (refinement,)),) = refine(Family((dexterity,)), targets, [weights], stream, amount)
    return filled, refinement


def fill_one(dexterity, targets, backend, stream, amount):
    """What ``fill`` leaves for a family of one."""
    return fill(Family((dexterity,)), targets, backend, stream, amount)[0]


def filled_by_numpy(dexterity, target, stream, samples, aggregate="max"):
    """What ``fill`` must give: values and hits, by ``numpy.ufunc.at``."""
    tips, raw = dexterity.raw(stream.points(0, samples, dexterity.arm.dof))
    grid = target.grid
    tips = tips @ target.T_grid_base[:3, :3].T + target.T_grid_base[:3, 3]
    cells = np.floor(tips / grid.r).astype(int) - grid.origin
    kept = ((cells >= 0) & (cells < grid.shape)).all(axis=1) & (raw >= 0)
    cells, value = tuple(cells[kept].T), np.minimum(raw[kept] / dexterity.normaliser, 1.0)
    hits, survivors = np.zeros(grid.shape, int), np.zeros(grid.shape, int)
    np.add.at(hits, cells, 1)
    passed = value >= dexterity.threshold
    cells, value = tuple(c[passed] for c in cells), value[passed]
    values = np.zeros(grid.shape)
    if aggregate == "max":
        np.maximum.at(values, cells, value)
    else:
        np.add.at(values, cells, value)
        np.add.at(survivors, cells, 1)
        values /= np.maximum(survivors, 1)
    return values, hits


def stream(sequence="plain", key=1):
    return Stream(sequence, key)
