"""How large the operators' workspaces are: python docs/examples/operators.py [VOXEL SIZES]"""

import sys

import numpy as np

from eiwa.core.evaluation import ergonomic_grid, field_stream
from eiwa.core.interfaces import Operator
from eiwa.core.registry import load

OPERATORS = {
    "`ehem`": ("ehem", {}),
    "`ehem_percentile`, woman, 5th": ("ehem_percentile", {"sex": "female", "percentile": 5.0}),
    "`ehem_percentile`, woman, 50th": ("ehem_percentile", {"sex": "female", "percentile": 50.0}),
    "`ehem_percentile`, man, 50th": ("ehem_percentile", {"sex": "male", "percentile": 50.0}),
    "`ehem_percentile`, man, 95th": ("ehem_percentile", {"sex": "male", "percentile": 95.0}),
    "`ehem_comfort`, rula, functional": ("ehem_comfort", {"metric": "rula"}),
    "`ehem_comfort`, luba, functional": ("ehem_comfort", {"metric": "luba"}),
    "`ehem_comfort`, quadratic, functional": ("ehem_comfort", {"metric": "quadratic"}),
    "`ehem_comfort`, rula, maximal": ("ehem_comfort", {"metric": "rula", "ranges": "maximal"}),
    "`free_arm`, comfort": ("free_arm", {"ranges": "comfort"}),
    "`free_arm`, functional": ("free_arm", {"ranges": "functional"}),
    "`free_arm`, maximal": ("free_arm", {"ranges": "maximal"}),
}


def build(kind, parameters):
    """A human model from the keys of its table."""
    plugin = load().find("human", kind, "human.kind")
    return plugin.build(plugin.parameters(**parameters))


def one_hand(human, r):
    """Where the right hand can be: litres of its cells, litres weighted by E, and the mean of E."""
    grid = ergonomic_grid([human.bounds(Operator())], r)
    E = human.field(grid, Operator(), field_stream(0, 0)).right
    litre = r**3 * 1000
    return np.count_nonzero(E) * litre, E.sum() * litre, E[E > 0].mean()


def extent(human):
    """Half the width of both hands' box, and from where to where it goes in y and z."""
    low, high = human.bounds(Operator())
    return f"±{high[0]:.2f} | {low[1]:.2f} to {high[1]:.2f} | {low[2]:.2f} to {high[2]:.2f}"


if __name__ == "__main__":
    sizes = [float(size) for size in sys.argv[1:]] or [0.02, 0.01]
    for name, (kind, parameters) in OPERATORS.items():
        human = build(kind, parameters)
        volumes = [one_hand(human, r) for r in sizes]
        cells = " | ".join(f"{volume:.1f}" for volume, _, _ in volumes)
        print(f"| {name} | {cells} | {volumes[0][1]:.1f} | {volumes[0][2]:.2f} | {extent(human)} |", flush=True)
