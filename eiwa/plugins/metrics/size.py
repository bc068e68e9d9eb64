"""Metrics of the arms themselves: how large they are and what they reach."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from eiwa.core.evaluation import Measurement
from eiwa.core.hookspecs import Number, Parameters, Plugin, hookimpl, quantity
from eiwa.core.interfaces import Metric


class ReachParameters(Parameters):
    """Largest distance of the tip from the base origin, within the joint limits."""


@dataclass(frozen=True)
class Reach(Metric):
    """Found by the same deterministic search as the normaliser, so free of sampling error."""

    parameters: ReachParameters

    def __call__(self, measurement: Measurement) -> dict[str, float | None]:
        """The reach [m]."""
        return {"reach": measurement.volumes.reach}


class LinkLengthParameters(Parameters):
    """Sum of the distances between consecutive joint frames, tool included."""


@dataclass(frozen=True)
class LinkLength(Metric):
    """None for an arm that has no such length."""

    parameters: LinkLengthParameters

    def __call__(self, measurement: Measurement) -> dict[str, float | None]:
        """The length [m]."""
        return {"total_link_length": measurement.setup.arm.link_length}


Counting = Literal["corrected", "cells"]
COUNTING: Any = quantity(
    "corrected",
    description="'cells' counts the study's own voxels with a sample above the threshold, as the paper does: it adds the "
    "border (+7 to +40 %) and misses holes; 'corrected' counts in 40 cells along the reach, whose holes are searched, "
    "and removes the border's layer.",
)


class SharedVolumeParameters(Parameters):
    """Volume that is dexterous for both arms, anywhere in W."""

    counting: Counting = COUNTING


@dataclass(frozen=True)
class SharedVolume(Metric):
    """Where both arms have a posture above the threshold."""

    parameters: SharedVolumeParameters

    def __call__(self, measurement: Measurement) -> dict[str, float | None]:
        """The volume [m3], replicate 0."""
        if self.parameters.counting == "corrected":
            return {"shared_volume": measurement.reached.shared}
        whole = measurement.whole
        cells = np.count_nonzero((whole.right.values > 0) & (whole.left.values > 0))
        return {"shared_volume": float(cells * whole.grid.r**3)}


class DexterousVolumeParameters(Parameters):
    """Volume of one arm's dexterous workspace."""

    counting: Counting = COUNTING


@dataclass(frozen=True)
class DexterousVolume(Metric):
    """Where one arm has a posture above the threshold; the two arms are equal."""

    parameters: DexterousVolumeParameters

    def __call__(self, measurement: Measurement) -> dict[str, float | None]:
        """The volume [m3], replicate 0."""
        if self.parameters.counting == "corrected":
            return {"dexterous_volume": measurement.reached.one_arm}
        cells = np.count_nonzero(measurement.mmdw.values > 0)
        return {"dexterous_volume": float(cells * measurement.setup.r**3)}


@hookimpl
def eiwa_metrics() -> list[Plugin]:
    """Size and volumes."""
    return [
        Plugin("reach", ReachParameters, Reach, (Number("reach", "m", "largest distance of tip and base", 0.0),)),
        Plugin(
            "total_link_length",
            LinkLengthParameters,
            LinkLength,
            (Number("total_link_length", "m", "sum of links", 0.0),),
        ),
        Plugin(
            "shared_volume",
            SharedVolumeParameters,
            SharedVolume,
            (Number("shared_volume", "m3", "dexterous for both arms", 0.0),),
        ),
        Plugin(
            "dexterous_volume",
            DexterousVolumeParameters,
            DexterousVolume,
            (Number("dexterous_volume", "m3", "dexterous for one arm", 0.0),),
        ),
    ]
