"""Lengths of people: ANSUR II, the US Army's survey of 2012 (4082 men, 1986 women; Gordon et al. 2014), public release.

Means, standard deviations and regressions on stature were computed from its raw data.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import ndtri

Sex = Literal["female", "male"]
Mode = Literal["stature", "each", "random"]


@dataclass(frozen=True)
class Length:
    """A measure's mean and standard deviation, and its regression on stature with the residuals' deviation [mm].

    One that is not regressed is taken to be independent of stature.
    """

    mean: float
    sd: float
    intercept: float
    slope: float
    residual: float

    @classmethod
    def independent(cls, mean: float, sd: float) -> Length:
        """A measure without a regression."""
        return cls(mean, sd, mean, 0.0, sd)


STATURE: Mapping[Sex, tuple[float, float]] = {"male": (1756.21, 68.55), "female": (1628.47, 64.20)}
"""Mean and standard deviation [mm]."""

LENGTHS: Mapping[Sex, Mapping[str, Length]] = {
    "male": {
        "upper_arm": Length(335.24, 17.48, -20.95, 0.2028, 10.6),
        "forearm": Length(286.94, 15.55, -11.15, 0.1697, 10.3),
        "hand": Length(193.28, 9.95, 21.74, 0.0977, 7.4),
        "forearm_breadth": Length(579.93, 50.93, 303.28, 0.1575, 49.8),
        "forearm_circumference": Length.independent(310.06, 21.99),
    },
    "female": {
        "upper_arm": Length(311.20, 17.16, -34.01, 0.2120, 10.5),
        "forearm": Length(258.78, 15.40, -23.25, 0.1732, 10.7),
        "hand": Length(181.08, 10.06, 16.23, 0.1012, 7.7),
        "forearm_breadth": Length(494.83, 41.01, 187.41, 0.1888, 39.2),
        "forearm_circumference": Length.independent(264.08, 18.52),
    },
}
"""Acromion to radiale; elbow to wrist crease; hand length; forearm-forearm breadth; forearm circumference, flexed."""


def lengths(sex: Sex, percentile: float, mode: Mode = "stature", seed: int = 0) -> dict[str, float]:
    """One person's stature and lengths [m].

    A percentile is mean + z sd of the normal distribution: smooth, and for stature within 5 mm of the survey's own
    percentiles from the 1st to the 95th (11 mm at men's 99th). People of one stature differ by more: 10 mm in the upper arm.

    Parameters
    ----------
    sex
        Whose survey.
    percentile
        Of stature, above 0 and below 100; with ``each`` of every length.
    mode
        ``stature``: each length by its regression, so that they agree with each other; ``each``: every length at its own
        percentile, a person who does not exist but bounds those who do; ``random``: the regressions and, from ``seed``,
        what a person deviates from them, independently for each length.
    """
    z = float(ndtri(percentile / 100))
    mean, sd = STATURE[sex]
    stature = mean + z * sd
    deviations = np.random.default_rng(seed).standard_normal(len(LENGTHS[sex])) if mode == "random" else np.zeros(5)
    person = {"stature": stature}
    for (name, length), deviation in zip(LENGTHS[sex].items(), deviations, strict=True):
        if mode == "each":
            person[name] = length.mean + z * length.sd
        else:
            person[name] = length.intercept + length.slope * stature + float(deviation) * length.residual
    return {name: value / 1000 for name, value in person.items()}
