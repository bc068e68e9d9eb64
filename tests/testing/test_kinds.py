"""Mistakes in indices, human models, voxel backends and metrics: which contract notices, and what it says."""

from pathlib import Path

import pytest

import eiwa.cli.templates
from eiwa import testing
from eiwa.core.registry import KINDS

TEMPLATES = Path(eiwa.cli.templates.__file__).parent

INDEX = "        return volume("
PREPARE = '''        return volume(arm.jacobian[:3]) * p[0]

    def prepare(self, arm, pilot):
        """Numbers."""
        import numpy as np

        return {}

    def unused(self, arm, margins):
        return volume('''
VALUES = '''        return volume(arm.jacobian[:3])

    def values(self, postures, prepared):
        """On arrays."""
        import numpy as np

        w = np.abs(np.linalg.det(postures.jacobians[:, :3, :3]))
        {}

    def unused(self, arm, margins):
        return volume('''
ALONE = "deposit_share(store: Any, cells: Any, values: Any, count: Any) -> None:\n"
FIELD = "        return ErgonomicField("
NUMBER = "        return {"

MISTAKES = {
    "dexterity": {
        "no index": ("MydeviceParameters, Mydevice)", "MydeviceParameters, lambda p: p)", "builds", "does not derive"),
        "numbers not finite": (INDEX, PREPARE.format("np.array([np.nan])"), "prepares_numbers", "finite numbers"),
        "a list": (INDEX, PREPARE.format("[1.0]"), "prepares_numbers", "a float64 array of shape (k,)"),
        "random numbers prepared": (INDEX, PREPARE.format("np.random.default_rng().random(1)"), "prepares_numbers",
                                    "random numbers"),
        "another shape": (INDEX, VALUES.format("return w[:, None]"), "has_the_right_shape", "shape (256,)"),
        "a sum": (INDEX, VALUES.format("return w.sum()"), "has_the_right_shape", "a sum over the wrong axis"),
        "negative": (INDEX, "        return -volume(", "is_finite_and_not_negative", "not below 0"),
        "zero": (INDEX, "        return 0.0 * volume(", "is_finite_and_not_negative", "0 at every posture"),
        "nan": (INDEX, VALUES.format("return np.sqrt(w - 1e-3)"), "is_finite_and_not_negative", "nan at posture"),
        "division by zero": (INDEX, VALUES.format("return w / np.linalg.norm(postures.jacobians, axis=(1, 2))"),
                             "survives_singular_postures", "a Jacobian of zeros"),
        "six joints only": (INDEX, VALUES.format("return w * (1 / (postures.q.shape[1] == 6))"), "serves_other_arms",
                            "ZeroDivisionError"),
        "best of the block": (INDEX, VALUES.format("return w / w.max()"), "survives_singular_postures", "zeros"),
        "less the block's mean": (INDEX, VALUES.format("return w + w.mean()"), "does_not_depend_on_the_block",
                                  "a mean, maximum or normalisation"),
        "postures changed": (INDEX, VALUES.format("postures.jacobians[:] = 0; return w"), "leaves_its_input_alone",
                             "jacobians was changed"),
        "two formulas": (INDEX, VALUES.format("return w"), "traced_form_is_the_array_form", "another formula"),
        "a python branch": ("if self.parameters.penalty else", "if arm.u[0] > 0.5 else", "has_the_right_shape", "truth value"),
        "structure knows too little": ("return self.parameters.penalty\n", "return True\n",
                                       "structure_tells_formulas_apart", "penalty is written"),
    },
    "human": {
        "no model": ("MydeviceParameters, Mydevice)", "MydeviceParameters, lambda p: p)", "builds", "does not derive"),
        "millimetres": ("-abs(x) - r,", "-1e3 * abs(x) - r,", "has_bounds", "millimetres"),
        "upside down": ("[[-abs(x) - r, y - r, z - r], [abs(x) + r", "[[abs(x) + r, y - r, z - r], [-abs(x) - r",
                        "has_bounds", "low below high"),
        "axes exchanged": (FIELD, "        return ErgonomicField(*(np.zeros((9, 9, 9)) for _ in '12'))\n"
                           "        ErgonomicField(", "has_the_grids_shape", "axes in another order"),
        "too comfortable": ("np.maximum(0.0, 1 - d", "np.maximum(0.0, 2 - d", "has_the_grids_shape", "in [0, 1]"),
        "nowhere": ("np.maximum(0.0, 1 - d", "0 * np.maximum(0.0, 1 - d", "has_the_grids_shape", "E = 0 everywhere"),
        "bounds too tight": ("[abs(x) + r, y + r, z + r]", "[abs(x) + r / 3, y + r, z + r]", "stays_within_its_bounds",
                             "x axis"),
        "bounds that stay": (" + [0, 0, operator.armrest]", "", "stays_within_its_bounds", "armrest raised"),
        "cells without origin": ("(grid.centres(axis) for axis in range(3))",
                                 "(self.bounds(operator)[0][a] + (np.arange(grid.shape[a]) + 0.5) * grid.r "
                                 "for a in range(3))", "stays_within_its_bounds", "without grid.origin"),
        "best of the grid": ("(1, -1)\n        )", "(1, -1)\n        )\n        right = right + 0.01 * right.max()",
                             "does_not_depend_on_the_grids_extent", "normalisation over the grid"),
        "lengths in cells": ("np.maximum(0.0, 1 - d", "np.maximum(0.0, 1 - 0.04 / grid.r * d",
                             "agrees_between_voxel_sizes", "lengths in cells"),
        "random numbers": (FIELD, "        right = right + 1e-3 * np.random.default_rng().random(right.shape)\n" + FIELD,
                           "is_deterministic", "do not come from the stream"),
        "sinks": ("(z - operator.armrest - bz)", "(z + operator.armrest - bz)", "stays_within_its_bounds", ""),
    },
    "voxels": {
        "no backend": ("lambda parameters: Mydevice()", "lambda parameters: parameters", "builds", "does not derive"),
        "no aggregate": ("aggregate: Literal", "other: Literal", "builds", "a parameter aggregate"),
        "not empty": ("np.zeros((cells, 2), np.int64)", "np.ones((cells, 2), np.int64)", "opens_empty", "1000 hits"),
        "survivors only": ("store[cells[s], 1] += 1\n", "store[cells[s], 1] += values[s] >= 0.0\n", "counts_every_hit",
                           "with value -1 are skipped"),
        "twice": ("store[cells[s], 1] += 1\n", "store[cells[s], 1] += 2\n", "counts_every_hit", "counts twice"),
        "below counted": ("values[s] >= 0.0", "values[s] >= -1.0", "keeps_survivors_only", "-1"),
        "all entries": ("range(count)", "range(len(cells))", "reads_count_samples", "behind count"),
        "the last one": ("store[cells[s], 0] += 1\n", "store[cells[s], 0] = int(100 * values[s]) % 2\n",
                         "does_not_depend_on_the_order_of_deposits", "the last value kept"),
        "hits not merged": ("into + other)", "into + other * [1, 0])", "does_not_depend_on_the_order_of_merging",
                            "merge forgets"),
        "a view": ("return np.asarray(store[:, 0] / np.maximum(store[:, 1], 1))",
                   "store[:, 2] = store[:, 0] / np.maximum(store[:, 1], 1); return store[:, 2]", "goes_on_after_reading",
                   "Return a copy"),
        "reading empties": ("return np.array(store[:, 1])", "hits = np.array(store[:, 1]); store[:] = 0; return hits",
                            "does_not_depend_on_the_order_of_merging", ""),
    },
    "metrics": {
        "no metric": ("MydeviceParameters, Mydevice, (", "MydeviceParameters, lambda p: p, (", "builds", "does not derive"),
        "no description": ('"right hand\'s share of what both can use"', '""', "declares_its_numbers", "a description"),
        "bounds reversed": ("0.0, 1.0)", "1.0, 0.0)", "declares_its_numbers", "low <= high"),
        "another name": (NUMBER + '"mydevice"', NUMBER + '"my_device"', "returns_what_it_declares", "my_device"),
        "no dict": (NUMBER + '"mydevice": ', "        return {0.0: ", "returns_what_it_declares", "of a design"),
        "an array": (NUMBER + '"mydevice": right', NUMBER + '"mydevice": first.E.right', "returns_what_it_declares",
                     "a float or None"),
        "nan": ("if right + left > 0 else None", "if right + left > 0 else float('nan')", "returns_what_it_declares",
                "over no cells"),
        "out of bounds": ("0.0, 1.0)", "0.0, 0.4)", "keeps_its_bounds", "between 0 and 0.4"),
        "random": (NUMBER + '"mydevice": right', "        import random\n" + NUMBER + '"mydevice": random.random() or right',
                   "is_deterministic", "random numbers"),
        "in place": ("        first = measurement.first\n",
                     "        first = measurement.first\n        first.V.right.values[:] *= 0.999\n", "is_deterministic", ""),
    },
}  # fmt: skip
CASES = [(kind, name) for kind, mistakes in MISTAKES.items() for name in mistakes]


def report(kind, folder, old="", new=""):
    """Results of the template with a mistake, by contract."""
    text = (TEMPLATES / f"{kind}.py").read_text()
    assert old in text, old
    if "store[:, 2]" in new:
        text = text.replace("(cells, 2), np.int64", "(cells, 3)")
    path = folder / "mydevice.py"
    path.write_text(text.replace(old, new, 1) if old else text)
    return {r.contract.replace(" ", "_"): r for r in testing.check(testing.subject(path))}


@pytest.mark.parametrize("kind", KINDS)
def test_the_right_one_passes(kind, tmp_path):
    assert {r.contract for r in report(kind, tmp_path).values() if r.state not in ("passed", "not applicable")} == set()


@pytest.mark.parametrize(("kind", "name"), CASES, ids=[f"{kind}: {name}" for kind, name in CASES])
def test_a_mistake_is_noticed(kind, name, tmp_path):
    old, new, contract, words = MISTAKES[kind][name]
    results = report(kind, tmp_path, old, new)
    failed = next((c for c, r in results.items() if r.state == "failed"), None)
    assert failed == contract, results
    assert words in results[failed].said
