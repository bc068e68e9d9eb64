"""What a sampler may know: the study as it stood when its trial was asked for.

A batch is asked for together, so a sampler knows the trials of earlier batches, and of its own batch only what was
proposed before. :class:`Before` shows it just that, whatever else has been told, written or lost since. So a study that
is interrupted, continued or rebuilt from its rows proposes what an uninterrupted one would have proposed.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from typing import Any
from weakref import WeakKeyDictionary

import optuna
from optuna.distributions import BaseDistribution
from optuna.samplers import BaseSampler
from optuna.trial import FrozenTrial, TrialState

_notes: WeakKeyDictionary[Any, dict[int, dict[str, Any]]] = WeakKeyDictionary()


class Before(optuna.Study):
    """A study at the time when a trial was asked for: earlier batches are finished, the rest of its own still runs."""

    def __init__(self, study: optuna.Study, number: int, batch: int) -> None:
        self.__dict__.update(study.__dict__, _storage=Unwritten(study._storage))
        first = number - number % batch
        trials = study._storage.get_all_trials(study._study_id, deepcopy=False)[:number]
        self._shown = [*trials[:first], *map(_running, trials[first:])]
        self.notes = _notes.setdefault(study._storage, {}).setdefault(study._study_id, {})
        """What samplers have worked out about earlier batches; nothing is lost when it is."""

    def _get_trials(
        self, deepcopy: bool = True, states: Container[TrialState] | None = None, use_cache: bool = False
    ) -> list[FrozenTrial]:
        return [t for t in self._shown if states is None or t.state in states]

    def completed(self) -> list[FrozenTrial]:
        """The complete trials of earlier batches."""
        return self._get_trials(states=(TrialState.COMPLETE,))


class Unwritten:
    """A storage that is read only: what a sampler would note down follows from the trials."""

    def __init__(self, storage: Any) -> None:
        self._storage = storage

    def __getattr__(self, name: str) -> Any:
        return getattr(self._storage, name)

    def set_trial_system_attr(self, *_: Any) -> None:
        """Nothing."""

    def set_study_system_attr(self, *_: Any) -> None:
        """Nothing."""


def _running(t: FrozenTrial) -> FrozenTrial:
    return FrozenTrial(
        number=t.number,
        state=TrialState.RUNNING,
        value=None,
        datetime_start=t.datetime_start,
        datetime_complete=None,
        params=t.params,
        distributions=t.distributions,
        user_attrs={},
        system_attrs={},
        intermediate_values={},
        trial_id=t._trial_id,
    )


class BatchSampler(BaseSampler):
    """Another sampler for one trial, which sees the study :class:`Before` it."""

    def __init__(self, inner: BaseSampler, space: Mapping[str, BaseDistribution], number: int, batch: int) -> None:
        self.inner, self._space, self._number, self._batch = inner, space, number, batch
        self._seen: Before | None = None

    def _before(self, study: optuna.Study) -> Before:
        if self._seen is None:
            self._seen = Before(study, self._number, self._batch)
        return self._seen

    def infer_relative_search_space(self, study: optuna.Study, trial: FrozenTrial) -> dict[str, BaseDistribution]:
        """All variables that have more than one value."""
        if isinstance(self.inner, optuna.samplers.TPESampler) and not self.inner._multivariate:
            return {}
        return {name: d for name, d in self._space.items() if not d.single()}

    def sample_relative(
        self, study: optuna.Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        """Values of all variables together."""
        return self.inner.sample_relative(self._before(study), trial, search_space)

    def sample_independent(
        self, study: optuna.Study, trial: FrozenTrial, param_name: str, param_distribution: BaseDistribution
    ) -> Any:
        """A value of one variable."""
        return self.inner.sample_independent(self._before(study), trial, param_name, param_distribution)
