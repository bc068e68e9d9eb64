"""How a sample's time depends on how many there are, on joints, voxels and threads."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from eiwa.bench.cases import PAPER, VOXEL, Case, chain
from eiwa.bench.measure import Contender, Record, Tell, keys, visit
from eiwa.core.dexterity import Dexterity, Family
from eiwa.core.filling import Sampling, fill
from eiwa.core.interfaces import NOTHING, ArmColumns, TracedIndex
from eiwa.core.linear import volume
from eiwa.core.sampling import Stream
from eiwa.core.symbols import Column

SAMPLES = 1 << 20
COUNTS = tuple(1 << k for k in (14, 16, 18, 20, 22))
SIZES = (0.04, 0.02, 0.01, 0.005, 0.0025)
JOINTS = tuple(range(1, 13))


class Manipulability(TracedIndex):
    """The product of J's singular values, for any number of joints."""

    structure = "benchmark: manipulability"

    def columns(self, arm: ArmColumns, p: Sequence[Column]) -> Column:
        """w alone."""
        return volume(arm.jacobian)


def contenders(threads: Sequence[int], tell: Tell, quick: bool = False) -> list[Contender]:
    """Each axis on one and on all threads; the axis of threads has the numbers in between."""
    paper = _family(PAPER)
    record = Record("scaling", "eiwa", "", "sample", PAPER.joints, "f64", 1, SAMPLES, VOXEL)
    bases = {t: _contender(paper, PAPER, replace(record, part="base", threads=t)) for t in threads}
    found: list[Contender] = list(bases.values())

    def add(family: Family, case: Case, part: str, **changes: float) -> None:
        for t, base in bases.items():
            found.append(_contender(family, case, replace(record, part=part, threads=t, **changes), base))  # type: ignore[arg-type]

    for samples in COUNTS[1:4:2] if quick else COUNTS:
        add(paper, PAPER, "samples", samples=samples)
    for r in SIZES[1:3] if quick else SIZES:
        add(paper, PAPER, "voxel", voxel=r)
    for joints in JOINTS[5:6] if quick else JOINTS:
        tell(f"preparing {joints} joints")
        case = chain(joints)
        add(_family(case), case, "joints", joints=joints)
    for t in between(max(threads)):
        found.append(_contender(paper, PAPER, replace(record, part="threads", threads=t), bases[1]))
    return found


def between(most: int) -> Iterator[int]:
    """1, 2, 4 ... and the last."""
    count = 1
    while count < most:
        yield count
        count *= 2
    yield most


def _family(case: Case) -> Family:
    return Family((Dexterity(case.setup.arm, Manipulability(), NOTHING, 1.0, 0.0),))


def _contender(family: Family, case: Case, record: Record, base: Contender | None = None) -> Contender:
    targets, backend = case.targets(record.voxel), case.setup.backend

    def call(samples: int) -> None:
        fill(family, targets, backend, Stream("plain", next(keys)), Sampling(samples, np.float64))

    call(1)
    return Contender(record, visit(call, record.samples), base)
