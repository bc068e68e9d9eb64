"""F and volumes of one design against the number of samples and the voxel size."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from eiwa.core.design import SECTIONS
from eiwa.core.outcome import evaluate
from eiwa.core.spec import StudySpec, check
from eiwa.core.tree import replaced

COUNTS = tuple(1 << k for k in (14, 16, 18, 20, 22))
FACTORS = (2.0, 1.0, 0.5)
BUDGET = 1 << 25


@dataclass(frozen=True)
class Point:
    """One setting, and what it gave: ``remaining`` and ``evaluations`` for elites alone."""

    estimator: str
    samples: int
    size: float
    F: float
    se: float | None
    dexterous_volume: float | None
    remaining: float | None


def sizes(spec: StudySpec) -> list[float]:
    """Twice, once and half the study's voxel size [m]."""
    size = spec.resolved["voxels"]["size"]
    return [size * factor for factor in FACTORS]


def points(spec: StudySpec, overrides: Mapping[str, Any], tolerance: float, replicates: int = 2) -> Iterator[Point]:
    """Plain samples at every N and r, then elites to the tolerance at every r (for the aggregate ``max``)."""
    plain = spec.resolved["sampling"]["estimator"]
    estimator = plain if plain != "elites" else "plain"
    for size in sizes(spec):
        for samples in COUNTS:
            yield _point(spec, overrides, estimator, samples, size, tolerance, replicates)
        if spec.resolved["voxels"].get("aggregate") == "max":
            yield _point(spec, overrides, "elites", BUDGET, size, tolerance, replicates)


def _point(
    spec: StudySpec,
    overrides: Mapping[str, Any],
    estimator: str,
    samples: int,
    size: float,
    tolerance: float,
    replicates: int,
) -> Point:
    settings = {
        "sampling.estimator": estimator,
        "sampling.samples": samples,
        "sampling.tolerance": tolerance,
        "voxels.size": size,
    }
    counting = "corrected" if estimator == "elites" else "cells"
    alone = bare(spec, overrides, settings, {"dexterous_volume": {"counting": counting}})
    numbers = evaluate(alone, {}, replicates).scenarios[""]
    spent = numbers.get("evaluations")
    return Point(
        estimator, int(spent or samples), size, numbers["F"] or 0.0, numbers["F_se"],
        numbers.get("dexterous_volume"), numbers["F_remaining"],
    )  # fmt: skip


def bare(
    spec: StudySpec, overrides: Mapping[str, Any], settings: Mapping[str, Any], metrics: Mapping[str, Any]
) -> StudySpec:
    """One design under the reference scenario, F and the given metrics alone, with other settings."""
    kept = {"F": spec.tree.get("metrics", {}).get("F", {}), **metrics}
    tree = replaced(spec.replaced(overrides), {**settings, "metrics": kept})
    design = {k: v for k, v in tree.items() if k in (*SECTIONS, "study", "plugins")}
    design["study"] = {**design["study"], "trials": 0}
    return check(design, spec.path)


def recommendation(found: Sequence[Point], wanted: float) -> str:
    """The cheapest setting whose F stays within ``wanted`` (relative) of the refined F on the same grid."""
    lines = []
    for size in dict.fromkeys(p.size for p in found):
        refined = next((p for p in found if p.size == size and p.estimator == "elites"), None)
        if refined is None:
            return "The aggregate is a mean: choose N so that F_se and F_drift are small enough."
        good = [
            p
            for p in found
            if p.size == size and p.estimator != "elites" and abs(p.F - refined.F) <= wanted * refined.F
        ]
        if good:
            cheapest = min(good, key=lambda p: p.samples)
            lines.append(f"r = {size:g} m: {cheapest.estimator}, samples = {cheapest.samples:_}")
        else:
            lines.append(
                f'r = {size:g} m: estimator = "elites", tolerance = {wanted:g} (about {refined.samples:_} evaluations)'
            )
    return "\n".join(lines)
