"""``eiwa bench``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eiwa.cli.console import AsJson, err, listen_to_log, out, print_json

if TYPE_CHECKING:
    from eiwa.bench.measure import Record

WEIGHTS = {"compare": 0.6, "share": 0.2, "scaling": 0.2}
"""What can be measured, and its part of the time."""


def bench(
    what: Annotated[
        list[str] | None, typer.Argument(metavar="[compare|share|scaling]...", help="What to measure; all by default.")
    ] = None,
    seconds: Annotated[
        float,
        typer.Option("--seconds", min=0, help="How long to measure; preparing (compiling at first) comes on top."),
    ] = 90.0,
    quick: Annotated[
        bool, typer.Option("--quick", help="A glance: 6 joints in double precision, everybody visited once.")
    ] = False,
    folder: Annotated[
        str | None, typer.Option("--out", metavar="FOLDER", help="Write bench.parquet and figures there.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Measure eiwa on this machine: beside other libraries and C++ by hand, where a trial's time goes, how it scales."""
    from eiwa.bench import measure
    from eiwa.core.errors import EiwaError
    from eiwa.core.tree import did_you_mean

    for name in what or ():
        if name not in WEIGHTS:
            raise EiwaError(f"{name}: cannot be measured{did_you_mean(name, WEIGHTS)}")
    asked = [name for name in WEIGHTS if not what or name in what]
    listen_to_log()
    where = measure.machine()
    with err().status("measuring") as status:
        records, left_out = _measured(asked, 0.0 if quick else seconds, quick, lambda text: status.update(text))
    if folder:
        from eiwa.report.bench import draw
        from eiwa.study.store import writing

        with writing(Path(folder)):
            Path(folder).mkdir(parents=True, exist_ok=True)
            measure.write(records, where, Path(folder) / "bench.parquet")
        drawn = draw(records, Path(folder))
        err().print(f"Wrote {Path(folder) / 'bench.parquet'}, drew {', '.join(map(str, drawn))}.", markup=False)
    wrong = [r for r in records if r.agrees is False]
    if as_json:
        print_json({"machine": where, "records": [asdict(r) for r in records], "left_out": left_out})
    else:
        _show(records, left_out, wrong)
    if wrong:
        sys.exit(1)


def _measured(
    asked: Sequence[str], seconds: float, quick: bool, tell: Callable[[str], None]
) -> tuple[list[Record], list[str]]:
    from eiwa.bench import compare, measure, scaling, share
    from eiwa.core.kernel import thread_count

    threads = sorted({1, thread_count()})
    budget = {name: seconds * WEIGHTS[name] / sum(WEIGHTS[n] for n in asked) for name in asked}
    records: list[Record] = []
    left_out: list[str] = []
    if "compare" in asked:
        settings: Any = ((6,), ("f64",)) if quick else ()
        contenders, left_out = compare.contenders(threads, tell, *settings)
        records += measure.interleaved(contenders, budget["compare"], tell)
    if "share" in asked:
        records += share.records(threads, budget["share"], tell, quick)
    if "scaling" in asked:
        records += measure.interleaved(scaling.contenders(threads, tell, quick), budget["scaling"], tell)
    return records, left_out


@dataclass(frozen=True)
class View:
    """A table of texts, to be printed or written into the docs."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]


def views(records: Sequence[Record]) -> list[View]:
    """Everything there is to see in the records, at most 80 columns wide."""
    found = []
    for name, build in (("compare", _compared), ("share", _shared), ("scaling", _scaled)):
        part = [r for r in records if r.what == name]
        if part:
            found += build(part)
    return found


def _compared(records: Sequence[Record]) -> list[View]:
    found = []
    for joints, precision in dict.fromkeys((r.joints, r.precision) for r in records):
        flows = [r for r in records if (r.joints, r.precision, r.part) == (joints, precision, "flow")]
        one = {r.who: r.seconds or 0.0 for r in reversed(flows)}
        rows = [
            [who, *(cell for t in _threads(records) for cell in _timed(_one(flows, who=who, threads=t)))]
            for who in sorted(one, key=lambda who: one[who])
        ]
        heads = [head for t in _threads(records) for head in (f"{_on(t)}ns", "±", "× eiwa")]
        found.append(View(f"From sample to voxels, {joints} joints, {precision}", ["who", *heads], rows))
    return [*found, *_roofs(records), *_array_forms(records), *_goals(records)]


def _timed(record: Record | None) -> list[str]:
    if record is None:
        return ["", "", ""]
    if record.agrees is False:
        return ["wrong", "", ""]
    assert record.seconds and record.upper is not None and record.lower is not None and record.ratio
    spread = (record.upper - record.lower) / 2 / record.seconds
    return [_number(1e9 * record.seconds), f"{spread:.0%}", _number(record.ratio)]


def _roofs(records: Sequence[Record]) -> list[View]:
    rows = []
    for product in (r for r in records if r.part == "product" and r.seconds):
        roof = _one(records, who="roof", **_setting(product))
        assert product.seconds and product.flops and product.ratio
        row = [*map(str, _setting(product).values()), str(product.flops)]
        row.append(f"{1e-9 * product.flops / product.seconds:.0f}")
        if roof and roof.ratio:
            row += [f"{product.ratio / roof.ratio:.0%}", _number(1 / roof.ratio)]
        rows.append([*row, *[""] * (7 - len(row))])
    columns = ["joints", "precision", "threads", "flop/sample", "GFLOP/s", "roof reaches", "eiwa / roof"]
    return [View("NumPy's matrix product, the roof, and eiwa", columns, rows)] if rows else []


def _array_forms(records: Sequence[Record]) -> list[View]:
    rows = []
    for rest in (r for r in records if r.part == "rest" and r.seconds and r.ratio):
        flow, roof = (_one(records, who=who, part="flow", **_setting(rest)) for who in (rest.who, "roof"))
        assert rest.seconds and rest.ratio and flow and flow.seconds
        times = [_number(1e9 * value) for value in (flow.seconds, rest.seconds)]
        over = _number(rest.ratio / roof.ratio) if roof and roof.ratio else ""
        rows.append([rest.who, str(rest.joints), str(rest.threads), *times, over])
    columns = ["with", "joints", "threads", "flow ns", "without its own ns", "that / roof"]
    return [View("An arm or an index in plain NumPy within eiwa's flow", columns, rows)] if rows else []


def _goals(records: Sequence[Record]) -> list[View]:
    """What eiwa aims at where there is AVX-512 (half of the first three on AVX2), and the range found."""
    aims = {
        "Pinocchio, C++ / eiwa": "at least 20", "NumPy, linalg.det / eiwa": "at least 40",
        "robotics-toolbox / eiwa": "at least 1000", "eiwa / roof": "at most 1.5",
        "rest of the array form / roof": "at most 4", "matrix product / roof": "at least 0.45",
    }  # fmt: skip
    found: dict[str, list[float]] = {name: [] for name in aims}
    for r in (r for r in records if r.seconds and r.ratio):
        roof = _one(records, who="roof", **_setting(r))
        assert r.seconds and r.ratio
        if f"{r.who} / eiwa" in found:
            found[f"{r.who} / eiwa"].append(r.ratio)
        elif r.who == "roof":
            found["eiwa / roof"].append(1 / r.ratio)
        elif r.part == "product" and roof and roof.ratio:
            found["matrix product / roof"].append(r.ratio / roof.ratio)
        elif r.part == "rest" and roof and roof.ratio:
            found["rest of the array form / roof"].append(r.ratio / roof.ratio)
    rows = [[name, aims[name], _number(min(seen)), _number(max(seen))] for name, seen in found.items() if seen]
    return [View("What eiwa aims at", ["ratio of times", "aim", "least", "most"], rows)] if rows else []


def _setting(record: Record) -> dict[str, Any]:
    return {"joints": record.joints, "precision": record.precision, "threads": record.threads}


def _shared(records: Sequence[Record]) -> list[View]:
    rows = []
    for stage in dict.fromkeys(r.part for r in records):
        cells = []
        for t in _threads(records):
            record = _one(records, part=stage, threads=t)
            assert record and record.seconds is not None and record.ratio is not None
            cells += [f"{1e3 * record.seconds:.2f}", f"{record.ratio:.1%}"]
        rows.append([stage, *cells])
    heads = [head for t in _threads(records) for head in (f"{_on(t)}ms", "share")]
    return [View("One trial of the paper's study", ["stage", *heads], rows)]


def _scaled(records: Sequence[Record]) -> list[View]:
    found = []
    for axis, unit in (("samples", ""), ("joints", ""), ("voxel", " [mm]"), ("threads", "")):
        part = [r for r in records if r.part == axis]
        columns = [0] if axis == "threads" else _threads(part)
        rows = []
        for value in dict.fromkeys(getattr(r, axis) for r in part):
            cells = []
            for t in columns:
                record = _one(part, **{"threads": t, axis: value})
                assert record and record.seconds and record.ratio
                cells += [_number(1e9 * record.seconds), _number(record.ratio)]
            rows.append([f"{1e3 * value:g}" if axis == "voxel" else f"{value:,}", *cells])
        heads = [head for t in columns for head in (f"{_on(t) if t else ''}ns", "ratio")]
        if rows:
            found.append(View(f"Scaling with {axis}", [axis + unit, *heads], rows))
    return found


def _one(records: Sequence[Record], **wanted: Any) -> Record | None:
    return next((r for r in records if all(getattr(r, k) == v for k, v in wanted.items())), None)


def _threads(records: Sequence[Record]) -> list[int]:
    """1 and all: the numbers of threads at which everybody who can is measured."""
    found = sorted({r.threads for r in records})
    return [found[0], found[-1]] if len(found) > 1 else found


def _on(threads: int) -> str:
    return f"{threads} thread{'s' * (threads > 1)}\n"


def _number(value: float) -> str:
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.1f}" if abs(value) >= 10 else f"{value:.2f}"


def _show(records: Sequence[Record], left_out: Sequence[str], wrong: Sequence[Record]) -> None:
    from eiwa.cli.tables import plain

    console, messages = out(), err()
    for view in views(records):
        console.print(plain(view.title, view.columns, view.rows))
    for who, joints, precision in dict.fromkeys((r.who, r.joints, r.precision) for r in wrong):
        messages.print(f"{who}, {joints} joints, {precision}: differs from eiwa, so it is not timed.", style="red")
    for reason in left_out:
        messages.print(f"left out: {reason}", style="dim", markup=False, soft_wrap=True)
    busy = [r.others for r in records if r.others is not None]
    if busy and max(busy) > 0.1:
        warning = f"Other processes kept {max(busy):.1f} cores busy: distrust the times, on several threads above all."
        messages.print(warning, style="yellow", soft_wrap=True)
