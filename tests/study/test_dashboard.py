"""The page of a study: its rows as Optuna's readers see them, and nothing that can be changed."""

import http.client
import io
import json
import threading
import urllib.request
from contextlib import contextmanager

import optuna
import pytest
from optuna.study import StudyDirection
from optuna.trial import TrialState

from eiwa.core.errors import EiwaError, StoreError
from eiwa.study.dashboard import listening, reading_only
from eiwa.study.page import Description, Page, front
from eiwa.study.rows import Task, failed, schema
from eiwa.study.store import Store
from tests.study import small

pytest.importorskip("optuna_dashboard")

TWO = small.OBJECTIVE + '[[objectives]]\nmetric = "reach"\ndirection = "minimize"\n\n'


def quiet(rows):
    """A description of how many rows there are."""
    yield Description(f"{len(rows)} rows", {0: "the first"}, {"card": {"data": [], "layout": {}}})


def page_of(spec, folder, describe=quiet):
    page = Page(spec, Store(folder / spec.study.name), describe)
    updates = page.updates()
    assert next(updates)
    return page, updates


def keep(spec, folder, changes, row=0):
    """Rows of a study that was run, again with changes, as its next part."""
    store = Store(folder / spec.study.name)
    trials = [r for r in store.rows() if r["kind"] == "trial"]
    store.write([trials[row] | change for change in changes], schema(spec))


@pytest.fixture
def ran(tmp_path, no_work):
    spec = small.spec()
    small.run(spec, tmp_path)
    return spec, tmp_path


def trials_of(page):
    return optuna.load_study(study_name="small", storage=page).get_trials(deepcopy=False)


# What is shown


def test_trials_are_those_of_the_rows(ran):
    spec, folder = ran
    page, _ = page_of(spec, folder)
    rows = {r["number"]: r for r in Store(folder / "small").rows() if r["kind"] == "trial"}
    found = trials_of(page)
    assert [t.number for t in found] == sorted(rows) == list(range(8))
    for trial in found:
        row = rows[trial.number]
        assert trial.values == [row["objectives.0"]]
        assert trial.params == {name: row[f"parameters.{name}"] for name in spec.ranges}
        assert trial.system_attrs["constraints"] == [row["constraints.0"]]
        assert trial.user_attrs["reach"] == row["metrics.reach"]
        assert ("breaks reach <= 0.4 by" in trial.user_attrs) is not row["feasible"]
    assert {r["feasible"] for r in rows.values()} == {True, False}


def test_trials_are_those_of_the_studys_journal(ran):
    """What the search was told, and what the page shows, is the same."""
    from eiwa.study.journal import storage

    spec, folder = ran
    page, _ = page_of(spec, folder)
    told = optuna.load_study(study_name="small", storage=storage(folder / "small/journal.log"))
    shown = optuna.load_study(study_name="small", storage=page)
    assert shown.metric_names == told.metric_names
    assert shown.directions == told.directions
    for one, other in zip(told.trials, shown.trials, strict=True):
        assert (one.state, one.params, one.values) == (other.state, other.params, other.values)
        assert one.system_attrs["constraints"] == other.system_attrs["constraints"]
        assert one.distributions == other.distributions


def test_states(ran):
    spec, folder = ran
    nothing = {name: None for name in schema(spec).names if name.startswith(("objectives.", "metrics."))}
    skipped = {"number": 8, "state": "SKIPPED", "feasible": False, "constraints.0": 0.25}
    failed = {"number": 10, "state": "FAIL", "feasible": None, "message": "the elbow is stuck"}
    keep(spec, folder, [nothing | skipped, nothing | failed])
    page, _ = page_of(spec, folder)
    states = {t.number: t.state for t in trials_of(page)}
    assert states[8] is TrialState.PRUNED
    assert page.get_trial(8).user_attrs == {"breaks reach <= 0.4 by": 0.25}
    assert states[9] is TrialState.RUNNING  # its row is not there yet
    assert states[10] is TrialState.FAIL
    assert page.get_trial(10).user_attrs == {"message": "the elbow is stuck"}


def test_a_trial_whose_worker_died_has_no_time(ran):
    spec, folder = ran
    store = Store(folder / "small")
    store.write([failed(spec, Task("trial", {}, 1, number=8), "its worker died")], schema(spec))
    page, _ = page_of(spec, folder)
    trial = page.get_trial(8)
    assert trial.state is TrialState.FAIL
    assert trial.datetime_complete == trial.datetime_start


def test_the_best_trial_meets_the_constraints(ran):
    spec, folder = ran
    keep(spec, folder, [{"number": 8, "objectives.0": 99.0, "constraints.0": 0.1, "feasible": False}])
    page, _ = page_of(spec, folder)
    met = [t for t in trials_of(page) if t.system_attrs["constraints"][0] <= 0]
    assert page.get_best_trial(0) is max(met, key=lambda t: t.values[0])


def test_where_no_trial_meets_the_constraints_the_least_infeasible_is_shown(tmp_path, no_work):
    spec = small.spec({"max = 0.40": "max = 0.05"})
    small.run(spec, tmp_path)
    page, _ = page_of(spec, tmp_path)
    least = min(trials_of(page), key=lambda t: t.system_attrs["constraints"])
    assert page.get_best_trial(0) is least


def test_the_front_leaves_out_what_breaks_a_constraint():
    def trial(number, values, violation):
        known = {"values": values, "system_attrs": {"constraints": [violation]}}
        made = optuna.trial.create_trial(**known)
        made.number = number
        return made

    trials = [
        trial(0, [1.0, 1.0], -1.0),
        trial(1, [2.0, 2.0], -1.0),
        trial(2, [1.0, 2.0], -1.0),  # dominated by both
        trial(3, [3.0, 0.5], +1.0),  # dominates all, but breaks the constraint
        trial(4, [2.0, 2.0], -1.0),  # equals one of the front
    ]
    directions = [StudyDirection.MAXIMIZE, StudyDirection.MINIMIZE]
    assert [t.number for t in front(trials, directions)] == [0, 1]
    assert front(trials[3:4], directions) == []


def test_the_front_is_optunas(tmp_path, no_work):
    spec = small.spec({small.OBJECTIVE: TWO, "trials = 8": "trials = 32"})
    small.run(spec, tmp_path)
    page, _ = page_of(spec, tmp_path)
    study = optuna.load_study(study_name="small", storage=page)
    assert [t.number for t in front(study.trials, study.directions)] == sorted(t.number for t in study.best_trials)


def test_a_study_without_a_search(tmp_path, no_work):
    spec = small.spec(small.NO_SEARCH | {small.OBJECTIVE: "", '[[constraints]]\nmetric = "reach"\nmax = 0.40\n': ""})
    small.run(spec, tmp_path)
    page, _ = page_of(spec, tmp_path)
    assert page.get_all_trials(0) == []
    assert detail(page)["note"]["body"] == "1 rows"


# What is new


def test_new_rows_come(ran):
    spec, folder = ran
    page, updates = page_of(spec, folder)
    assert not next(updates)
    keep(spec, folder, [{"number": 8}, {"number": 9}])
    assert next(updates)
    assert len(trials_of(page)) == 10
    assert detail(page)["note"]["body"] == f"{len(Store(folder / 'small').rows())} rows"
    assert not next(updates)


def test_the_first_rows_come(ran, tmp_path):
    """A page that is opened before the first row is there."""
    spec, folder = ran
    rows = Store(folder / "small").rows()
    empty = tmp_path / "empty"
    page, updates = page_of(spec, empty)
    assert page.get_all_trials(0) == []
    assert [next(updates) for _ in range(3)] == [False] * 3
    (empty / "small/trials").mkdir(parents=True)
    Store(empty / "small").write(rows, schema(spec))
    assert next(updates)
    assert len(trials_of(page)) == 8


def test_rows_that_are_put_together_stay(ran):
    spec, folder = ran
    page, updates = page_of(spec, folder)
    before = [(t.number, t.values) for t in trials_of(page)]
    store = Store(folder / "small")
    rows, parts = store.rows(), store.parts
    store.write(rows, schema(spec))
    for part in parts:
        part.unlink()
    assert not next(updates)
    assert next(updates)
    assert [(t.number, t.values) for t in trials_of(page)] == before


def test_a_part_that_cannot_be_read_is_looked_at_again(ran):
    spec, folder = ran
    page, updates = page_of(spec, folder)
    part = folder / "small/trials/part-000099.parquet"
    part.write_bytes(b"PAR1")
    assert not next(updates)
    assert not next(updates)
    assert len(trials_of(page)) == 8
    part.unlink()
    keep(spec, folder, [{"number": 8}])
    assert next(updates)
    assert len(trials_of(page)) == 9


def test_rows_that_cannot_be_read_at_first_are_told(ran):
    spec, folder = ran
    (folder / "small/trials/part-000099.parquet").write_bytes(b"PAR1")
    with pytest.raises(StoreError, match="is damaged"):
        page_of(spec, folder)


def test_descriptions_come_one_after_the_other(ran):
    spec, folder = ran

    def twice(rows):
        yield Description("at once", {}, {})
        yield Description("later", {}, {})

    page, updates = page_of(spec, folder, twice)
    assert detail(page)["note"]["body"] == "at once"
    assert next(updates)
    assert detail(page)["note"]["body"] == "later"
    assert not next(updates)


# What can be changed: nothing


def refused(page):
    study = optuna.load_study(study_name="small", storage=page)
    yield lambda: study.set_user_attr("key", "value")
    yield lambda: study.set_metric_names(["other"])
    yield lambda: study.tell(0, 1.0)
    yield lambda: study.ask()
    yield lambda: study.add_trial(study.trials[0])
    yield lambda: optuna.delete_study(study_name="small", storage=page)
    yield lambda: optuna.create_study(study_name="other", storage=page)


@pytest.mark.filterwarnings("ignore::optuna.exceptions.ExperimentalWarning")
def test_nothing_can_be_written(ran):
    spec, folder = ran
    before = content(folder)
    page, _ = page_of(spec, folder)
    for number, attempt in enumerate(refused(page)):
        with pytest.raises((StoreError, ValueError)) as told:
            attempt()
        assert isinstance(told.value, StoreError) or number == 2  # a finished trial is refused by Optuna itself
    assert content(folder) == before


def content(folder):
    return {p: p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH"])
def test_requests_that_change_something_do_not_reach_the_page(method):
    def app(environ, start_response):
        raise AssertionError

    said = []
    answer = reading_only(app)({"REQUEST_METHOD": method, "wsgi.input": io.BytesIO()}, lambda *a: said.append(a))
    assert said[0][0] == "403 Forbidden"
    assert "only shows the study" in json.loads(b"".join(answer))["reason"]


# The server


@contextmanager
def served(page):
    server = listening(page, "127.0.0.1", 0)
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def detail(page):
    """What the page in the browser asks for."""
    with served(page) as address, urllib.request.urlopen(f"{address}/api/studies/0") as answer:
        return json.load(answer)


def test_a_request_without_the_headers_of_a_browser(ran):
    spec, folder = ran
    page, _ = page_of(spec, folder)
    with served(page) as address:
        connection = http.client.HTTPConnection(address.removeprefix("http://"), timeout=60)
        connection.putrequest("GET", "/favicon.ico", skip_accept_encoding=True)
        connection.endheaders()
        assert connection.getresponse().status == 200
        connection.close()


def test_the_browser_is_told_names_constraints_notes_and_figures(ran):
    spec, folder = ran
    page, _ = page_of(spec, folder)
    found = detail(page)
    assert found["name"] == "small"
    assert found["objective_names"] == ["F"]
    assert found["note"]["body"] == f"{len(Store(folder / 'small').rows())} rows"
    assert [t["note"]["body"] for t in found["trials"]][:2] == ["the first", ""]
    assert [c["id"] for c in found["plotly_graph_objects"]] == ["card"]
    assert {len(t["constraints"]) for t in found["trials"]} == {1}
    (best,) = found["best_trials"]
    assert best["constraints"][0] <= 0


def test_the_browser_is_told_a_front_without_broken_constraints(tmp_path, no_work):
    spec = small.spec({small.OBJECTIVE: TWO, "trials = 8": "trials = 32"})
    small.run(spec, tmp_path)
    page, _ = page_of(spec, tmp_path)
    best = detail(page)["best_trials"]
    assert len(best) > 1
    assert all(t["constraints"][0] <= 0 for t in best)


def test_a_port_in_use_is_told(ran):
    spec, folder = ran
    page, _ = page_of(spec, folder)
    with served(page) as address:
        port = int(address.rsplit(":", 1)[1])
        with pytest.raises(EiwaError, match=f"--port {port}: is in use; choose another with --port"):
            listening(page, "127.0.0.1", port)


def test_a_host_that_is_not_here_is_told(ran):
    spec, folder = ran
    page, _ = page_of(spec, folder)
    with pytest.raises(EiwaError, match=r"--host 192\.0\.2\.1"):
        listening(page, "192.0.2.1", 0)
