"""Samplers with generations, which follow from the trials' numbers and states alone: NSGA-II, NSGA-III, CMA-ES.

Optuna's own note in its storage which generation a trial belongs to; a journal that is lost loses that. Here a
generation is the batches asked for until at least ``size`` of their trials are complete.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import optuna
from optuna.samplers import NSGAIIISampler, NSGAIISampler, RandomSampler
from optuna.samplers.nsgaii import PolynomialMutation, SBXCrossover
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial

from eiwa.core import samplers
from eiwa.core.sections import RangeSection
from eiwa.study.batch import Before
from eiwa.study.ranges import place, scaled

Seeded = Callable[[int], int]
"""From a trial's number to its seed."""


def generations(completed: Sequence[FrozenTrial], batch: int, size: int) -> list[list[FrozenTrial]]:
    """The complete trials of earlier batches by generation; the last one is the generation that a next batch joins."""
    found: list[list[FrozenTrial]] = [[]]
    for i, trial in enumerate(completed):
        begins = i == 0 or trial.number // batch != completed[i - 1].number // batch
        if begins and len(found[-1]) >= size:
            found.append([])
        found[-1].append(trial)
    return found if len(found[-1]) < size else [*found, []]


class _Generational:
    """Generations and parents of a genetic sampler, from the trials.

    Simulated binary crossover and polynomial mutation, as in Deb et al. (2002, doi:10.1109/4235.996017): Optuna's
    defaults, which exchange values or draw them anew, refine nothing where variables are continuous.
    """

    def __init__(self, options: samplers.Nsga2, batch: int, seeded: Seeded, number: int, **more: Any) -> None:
        self._options, self._batch, self._seeded = options, batch, seeded
        super().__init__(  # type: ignore[call-arg]
            population_size=options.population_size,
            crossover=SBXCrossover(),
            mutation=PolynomialMutation(),
            crossover_prob=options.crossover_probability,
            mutation_prob=options.mutation_probability,
            seed=seeded(number),
            **more,
        )

    def _generations(self, study: Before) -> list[list[FrozenTrial]]:
        return generations(study.completed(), self._batch, self._options.population_size)

    def get_trial_generation(self, study: Before, trial: FrozenTrial) -> int:
        """The generation that is being filled."""
        return len(self._generations(study)) - 1

    def get_population(self, study: Before, generation: int) -> list[FrozenTrial]:
        """Its complete trials."""
        return self._generations(study)[generation]

    def get_parent_population(self, study: Before, generation: int) -> list[FrozenTrial]:
        """Its parents; each generation's are chosen by its own random numbers, whichever trial asks first."""
        parents: list[list[FrozenTrial]] = study.notes.setdefault("parents", [[]])
        while len(parents) <= generation:
            last = max(t.number for t in self.get_population(study, len(parents) - 1))
            chooser: Any = type(self)(self._options, self._batch, self._seeded, last)
            parents.append(chooser.select_parent(study, len(parents)))
        return parents[generation]


class Nsga2(_Generational, NSGAIISampler):  # type: ignore[misc]
    """Optuna's NSGA-II with generations that follow from the trials."""


class Nsga3(_Generational, NSGAIIISampler):  # type: ignore[misc]
    """Optuna's NSGA-III with generations that follow from the trials."""

    def __init__(self, options: samplers.Nsga3, batch: int, seeded: Seeded, number: int) -> None:
        super().__init__(options, batch, seeded, number, dividing_parameter=options.divisions)


class CmaEs(RandomSampler):
    """CMA-ES on the ranges' unit cube, told every generation anew: its state follows from the trials.

    A generation is told its ranks, by the feasibility rules of Deb (2000, doi:10.1016/S0045-7825(99)00389-8): feasible
    designs by their objective, then the others by their violations, each as a share of the generation's largest.
    """

    def __init__(
        self, options: samplers.Cmaes, batch: int, ranges: Mapping[str, RangeSection], seeded: Seeded, number: int
    ) -> None:
        super().__init__(seed=seeded(number))
        self._options, self._batch, self._ranges = options, batch, ranges
        self._seeded = seeded

    @property
    def population_size(self) -> int:
        """As asked, or what is usual for the number of variables, up to whole batches."""
        usual = 4 + int(3 * np.log(len(self._ranges)))
        return self._options.population_size or -(-usual // self._batch) * self._batch

    def sample_relative(self, study: Any, trial: FrozenTrial, search_space: Any) -> dict[str, float]:
        """A draw of the distribution that the generations so far have led to."""
        *finished, _ = generations(study.completed(), self._batch, self.population_size)
        told, optimizer = study.notes.setdefault("cma", [0, self._beginning()])
        for generation in finished[told:]:
            optimizer.tell(self._ranked(study, generation[: self.population_size]))
        study.notes["cma"] = [len(finished), optimizer]
        optimizer.reseed_rng(self._seeded(trial.number))
        units = dict(zip(self._ranges, optimizer.ask(), strict=True))
        return {name: scaled(self._ranges[name], min(max(units[name], 0.0), 1.0)) for name in search_space}

    def _beginning(self) -> Any:
        from cmaes import CMA

        n = len(self._ranges)
        bounds = np.tile([0.0, 1.0], (n, 1))
        return CMA(np.full(n, 0.5), self._options.sigma, bounds, 10 * n, population_size=self.population_size)

    def _ranked(self, study: optuna.Study, generation: Sequence[FrozenTrial]) -> list[tuple[Any, float]]:
        values = np.array([t.values[0] for t in generation])
        if study.direction is StudyDirection.MAXIMIZE:
            values = -values
        violations = np.array([[max(v, 0.0) for v in t.constraints.values()] for t in generation])
        total = (violations / np.maximum(violations.max(axis=0, initial=0.0), 1e-300)).sum(axis=1)
        order = np.lexsort((values, total))
        points = [np.array([place(r, t.params[name]) for name, r in self._ranges.items()]) for t in generation]
        return [(points[i], float(rank)) for rank, i in enumerate(order)]
