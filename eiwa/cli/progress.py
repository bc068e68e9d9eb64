"""Progress of a study on stderr: stage, count, best so far, time left."""

from __future__ import annotations

from collections.abc import Iterable
from types import TracebackType
from typing import TYPE_CHECKING, Any

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from eiwa.core.spec import StudySpec

if TYPE_CHECKING:
    from eiwa.study.rows import Row


class StudyProgress:
    """Listens to a run: one bar a stage."""

    def __init__(self, spec: StudySpec, console: Any) -> None:
        self._spec = spec
        self._best: Row | None = None
        self._tasks: dict[str, Any] = {}
        self._progress = Progress(
            TextColumn("{task.description:<9}"),
            BarColumn(bar_width=24),
            MofNCompleteColumn(),
            TextColumn("{task.fields[best]}"),
            TimeRemainingColumn(compact=True),
            console=console,
        )

    def __enter__(self) -> StudyProgress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._tasks:
            self._progress.stop()

    def begin(self, stage: str, total: int, done: int, known: Iterable[Row] = ()) -> None:
        """A stage with ``done`` of ``total`` evaluations behind it; the best of the known ones is the best so far."""
        for row in known:
            self._look(stage, row)
        self._progress.start()
        self._tasks[stage] = self._progress.add_task(stage, total=total, completed=done, best=self._label(stage))

    def __call__(self, stage: str, row: Row) -> None:
        """One more evaluation."""
        self._look(stage, row)
        self._progress.update(self._tasks[stage], advance=1, best=self._label(stage))

    def say(self, line: str) -> None:
        """A line above the bars."""
        self._progress.console.print(line, markup=False, soft_wrap=True)

    def _look(self, stage: str, row: Row) -> None:
        if stage == "search" and row["state"] == "COMPLETE" and row["feasible"] and self._better(row):
            self._best = row

    def _better(self, row: Row) -> bool:
        sign = 1.0 if self._spec.objectives[0].direction == "maximize" else -1.0
        return self._best is None or sign * (row["objectives.0"] - self._best["objectives.0"]) > 0

    def _label(self, stage: str) -> str:
        if self._best is None or stage != "search":
            return ""
        return f"best {self._spec.objectives[0].label} {self._best['objectives.0']:.4f}"
