"""Metrics of the ergonomic interaction workspace: Eq. (4), its share F, and what surrounds it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from eiwa.core.evaluation import Measurement, Replicate
from eiwa.core.hookspecs import Number, Parameters, Plugin, hookimpl, quantity
from eiwa.core.interfaces import Array, Metric
from eiwa.core.interval import interval

Volume = Literal["sum", "union"]


class FParameters(Parameters):
    """F = V_I / V_R: share of the ergonomic workspace that is dexterous, Eq. (4).

    Within [0, 1] for ``sum``; for ``union`` at most the largest E_left + E_right.
    """

    volume: Volume = quantity(
        "sum", description="V_R: 'sum' of E_left + E_right, or 'union', the number of cells with E > 0."
    )


@dataclass(frozen=True)
class F(Metric):
    """V_I = sum (E_left + E_right) V_dual over V_R; its spread over replicates; its change from N/2 to N."""

    parameters: FParameters

    def __call__(self, measurement: Measurement) -> dict[str, float | None]:
        """F of replicate 0, the standard deviation over full-size replicates, its interval, F(N) - F(N/2)."""
        values = [self.ratio(r.E_sum, r.V_dual) for r in measurement.replicates]
        drift, remaining, evaluations = self._convergence(measurement.first, values[0])
        se = float(np.std(values, ddof=1)) if len(values) > 1 else None
        low, high = None, None
        if se is not None and remaining is not None:
            low, high = interval(values[0], se, remaining, len(values))
        return {
            "F": values[0],
            "F_se": se,
            "F_low": low,
            "F_high": high,
            "F_drift": drift,
            "F_remaining": remaining,
            "evaluations": evaluations,
        }

    def _convergence(self, first: Replicate, value: float) -> tuple[float | None, float | None, float | None]:
        """F(N) - F(N/2); for elites also what F may still gain, and the evaluations spent."""
        if first.refinement is not None:
            unit = 2 * first.alpha * self.ratio(first.E_sum, np.ones_like(first.E_sum))
            refinement = first.refinement
            drift = value - unit * refinement.at_half()
            return drift, unit * refinement.remaining, float(refinement.history[-1][0])
        half = first.V_dual_half
        return (None if half is None else value - self.ratio(first.E_sum, half)), None, None

    def ratio(self, E_sum: Array, V_dual: Array) -> float:
        """V_I / V_R, 0 for an empty ergonomic workspace."""
        V_R = E_sum.sum() if self.parameters.volume == "sum" else np.count_nonzero(E_sum)
        return float((E_sum * V_dual).sum() / V_R) if V_R > 0 else 0.0


class FVolumeParameters(Parameters):
    """Share of the ergonomic volume where V_dual reaches the isovalue."""

    isovalue: float = quantity(0.3, ge=0, le=1, source="the paper, Fig. 3", description="Least V_dual that counts.")


@dataclass(frozen=True)
class FVolume(Metric):
    """Cells with E > 0 and V_dual >= isovalue, over cells with E > 0."""

    parameters: FVolumeParameters

    def __call__(self, measurement: Measurement) -> dict[str, float | None]:
        """The share, replicate 0."""
        ergonomic = measurement.first.E_sum > 0
        passed = ergonomic & (measurement.first.V_dual >= self.parameters.isovalue)
        return {"F_volume": float(passed.sum() / max(1, ergonomic.sum()))}


class MeanDexterityParameters(Parameters):
    """Mean of V_dual over the cells with E > 0."""


@dataclass(frozen=True)
class MeanDexterity(Metric):
    """How dexterous the arms are where the hands are comfortable, every cell counted alike."""

    parameters: MeanDexterityParameters

    def __call__(self, measurement: Measurement) -> dict[str, float | None]:
        """The mean, replicate 0."""
        inside = measurement.first.V_dual[measurement.first.E_sum > 0]
        return {"mean_dexterity": float(inside.mean()) if inside.size else 0.0}


class SingletonsParameters(Parameters):
    """f1/N: share of samples alone in their voxel, an alarm for under-sampling (Good-Turing)."""


@dataclass(frozen=True)
class Singletons(Metric):
    """Voxels of E's grid with exactly one sample over the samples that fell into it, both arms, before any threshold.

    It estimates the probability that the next sample opens a new voxel.
    """

    parameters: SingletonsParameters

    def __call__(self, measurement: Measurement) -> dict[str, float | None]:
        """The share, replicate 0; 1 where no sample fell into the grid, None for elites, which do not sample evenly."""
        sides = [side.hits for side in (measurement.first.V.right, measurement.first.V.left)]
        if any(hits is None for hits in sides):
            return {"singletons": None}
        hits = np.concatenate([np.ravel(hits) for hits in sides if hits is not None])
        total = int(hits.sum())
        return {"singletons": float(np.count_nonzero(hits == 1) / total) if total else 1.0}


class ValidShareParameters(Parameters):
    """Share of joint vectors within the joint limits that are valid.

    The others have no solution, or lie outside coupled limits. They count as samples, and are left out of all else.
    """


@dataclass(frozen=True)
class ValidShare(Metric):
    """Of the fixed pilot of 2^14 postures, so free of the study's randomness."""

    parameters: ValidShareParameters

    def __call__(self, measurement: Measurement) -> dict[str, float | None]:
        """The share."""
        return {"valid_share": measurement.dexterity.valid_share}


@hookimpl
def eiwa_metrics() -> list[Plugin]:
    """F and its company."""
    return [
        Plugin(
            "F",
            FParameters,
            F,
            (
                Number("F", "", "share of the ergonomic workspace that is dexterous", 0.0, 2.0),
                Number("F_se", "", "standard deviation of F over full-size replicates", 0.0),
                Number("F_low", "", "elites: lower end of the 95 % interval of the true F on the grid", -1.0, 2.0),
                Number("F_high", "", "elites: its upper end", 0.0, 4.0),
                Number("F_drift", "", "F at N samples less F at N/2", -2.0, 2.0),
                Number("F_remaining", "", "elites: how far F may still rise", 0.0),
                Number("evaluations", "", "elites: samples spent before the tolerance was met", 0.0),
            ),
        ),
        Plugin(
            "F_volume",
            FVolumeParameters,
            FVolume,
            (Number("F_volume", "", "share with V_dual >= isovalue", 0.0, 1.0),),
        ),
        Plugin(
            "mean_dexterity",
            MeanDexterityParameters,
            MeanDexterity,
            (Number("mean_dexterity", "", "mean V_dual inside E", 0.0, 1.0),),
        ),
        Plugin(
            "singletons",
            SingletonsParameters,
            Singletons,
            (Number("singletons", "", "f1/N, under-sampling alarm", 0.0, 1.0),),
        ),
        Plugin(
            "valid_share",
            ValidShareParameters,
            ValidShare,
            (Number("valid_share", "", "share of joint vectors that are valid", 0.0, 1.0),),
        ),
    ]
