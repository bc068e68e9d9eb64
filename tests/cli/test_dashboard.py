"""``eiwa study dashboard`` as a real process, looked at with a real browser that can reach nothing but this machine."""

import os
import re
import shutil
import signal
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from tests.cli.conftest import cli  # noqa: F401 (a fixture)
from tests.needs import need
from tests.study import small

pytest.importorskip("optuna_dashboard")

ALONE = "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1"
GRAPHICS = "--enable-unsafe-swiftshader"
"""3-D figures without a graphics card."""
COUNT = """[...document.querySelectorAll('.js-plotly-plot')]
    .filter(plot => plot.layout?.title?.text === 'F of every trial').flatMap(plot => plot.data)
    .filter(trace => trace.name === 'trial' || trace.name === 'breaks a constraint')
    .reduce((sum, trace) => sum + trace.x.length, 0)"""
"""How many trials eiwa's own history shows."""
PATIENCE = 200_000
"""Milliseconds: a machine may have other work."""
PICTURES = os.environ.get("EIWA_PICTURES")
"""A folder for screenshots, for people."""


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A study that was run: scenarios, a constraint that some trials break, an assumption."""
    folder = tmp_path_factory.mktemp("dashboard")
    extra = small.SCENARIOS + '\n[assumptions]\n"layout.offset" = "read off a figure"\n'
    small.write(folder, {"trials = 8": "trials = 16"}, extra)
    code, _, err = small.eiwa("study", "run", "small.toml", folder=folder)
    assert code == 0, err
    return folder


@pytest.fixture(scope="module")
def browser():
    """Chromium; outside this machine nothing can be reached."""
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    need("chromium", found, "no Chromium: apt-get install chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=found, args=["--no-sandbox", ALONE, GRAPHICS])
        yield started
        started.close()


class Dashboard:
    """The command in a folder, with where it says that it can be reached."""

    def __init__(self, folder, *arguments):
        self.process = small.start("study", "dashboard", "small.toml", "--port", 0, *arguments, folder=folder)
        self.line = self.process.stdout.readline()
        found = re.fullmatch(r"small: (http://127\.0\.0\.1:\d+/dashboard/studies/0) \(Ctrl-C ends it\)\n", self.line)
        assert found, self.line + self.process.communicate(timeout=120)[1]
        self.address = found[1]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()


@pytest.fixture(scope="module")
def dashboard(study):
    with Dashboard(study) as running:
        yield running


class Seen:
    """A page in the browser, with every request and what it says on its console."""

    def __init__(self, browser, address):
        self.page = browser.new_page(viewport={"width": 1400, "height": 2300})
        self.page.set_default_timeout(PATIENCE)
        self.requests, self.errors = [], []
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("console", lambda message: message.type == "error" and self.errors.append(message.text))
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.address = address
        self.page.goto(address)

    def text(self, *words):
        """Wait for texts."""
        for word in words:
            self.page.get_by_text(word).first.wait_for()

    def table(self):
        """The cells of every line of every table."""
        self.page.locator("tr").first.wait_for()
        lines = [line.inner_text() for line in self.page.locator("tr").all()]
        return [[cell.strip() for cell in line.split("\t")] for line in lines]

    def figure(self, name):
        """The data of a figure that plotly has drawn, by its title."""
        found = """title => [...document.querySelectorAll('.js-plotly-plot')]
            .filter(plot => plot.layout?.title?.text?.startsWith(title))
            .map(plot => plot.data.map(t => ({name: t.name, x: t.x, y: t.y, error: t.error_y?.array, type: t.type})))[0]"""
        self.page.wait_for_function(found, arg=name)
        return {trace["name"]: trace for trace in self.page.evaluate(found, name)}

    def picture(self, name):
        if PICTURES:
            self.page.wait_for_timeout(2000)
            self.page.screenshot(path=Path(PICTURES) / f"{name}.png")


@pytest.fixture(scope="module")
def see(browser):
    """Open an address, or go back to the page that shows it."""
    opened = {}

    def look(address):
        if address not in opened:
            opened[address] = Seen(browser, address)
        return opened[address]

    yield look
    for seen in opened.values():
        seen.page.close()


@pytest.fixture(scope="module")
def rows(study):
    from eiwa.study.store import Store

    return Store(study / "runs/small").rows()


def of_kind(rows, kind):
    return [r for r in rows if r["kind"] == kind]


# What is on the page


def test_the_page_shows_the_study(dashboard, see, rows):
    seen = see(dashboard.address)
    seen.text("small (id=0)", "Hyperparameter Importance", "Best Trial (number=", "reach <= 0.4")
    broken = [r["number"] for r in of_kind(rows, "trial") if not r["feasible"]]
    met = [r["number"] for r in of_kind(rows, "trial") if r["feasible"]]
    assert broken and met
    history = seen.figure("F of every trial")
    assert history["breaks a constraint"]["x"] == broken
    assert history["trial"]["x"] == met
    (design,) = of_kind(rows, "design")
    assert history["optimum"]["y"] == pytest.approx([design["metrics.F"]] * 2, rel=1e-5)
    assert history["optimum"]["error"] == pytest.approx([design["metrics.F_se"]] * 2, rel=1e-5)
    under = seen.figure("F under every scenario")["optimum"]
    assert under["x"] == ["K=12270 *", "K=50"]
    assert under["y"] == pytest.approx([design["metrics.F"], design["metrics.F@dexterity.K=50"]], rel=1e-5)
    workspace = seen.figure("Interaction workspace of trial ")
    assert workspace["share of V_I"]["type"] == "scatter3d"
    assert len(workspace["share of V_I"]["x"]) > 10
    seen.picture("study")
    assert seen.errors == []
    assert all(url.startswith(dashboard.address.split("/dashboard")[0]) for url in seen.requests)


def test_optuna_dashboards_own_cards_draw_broken_constraints_as_infeasible(dashboard, see, rows):
    seen = see(dashboard.address)
    seen.text("Timeline")
    found = """() => [...document.querySelectorAll('.js-plotly-plot')].flatMap(plot => plot.data)
        .filter(trace => trace.name === 'Infeasible').map(trace => trace.y)"""
    seen.page.wait_for_function(f"({found})().length > 0")
    (drawn,) = seen.page.evaluate(found)
    assert drawn == [r["number"] for r in of_kind(rows, "trial") if not r["feasible"]]


def test_the_note_tells_what_the_study_asks_and_found(dashboard, see, rows):
    from eiwa.cli.tables import with_error

    seen = see(f"{dashboard.address}/note")
    seen.text("Maximize", "What the search chooses", "Assumptions")
    (design,) = of_kind(rows, "design")
    cells = [[line[0].removesuffix(" ~"), *line[1:]] for line in seen.table()]
    F = with_error(design["metrics.F"], design["metrics.F_se"])
    assert ["optimum", "0.26", "0.18", "0.2", F, "0.2732"] in cells
    best = min(of_kind(rows, "leader"), key=lambda r: -r["metrics.F"])
    (line,) = [c for c in cells if c[0] == f"trial {best['number']}" and len(c) > 3]
    assert line[4] == with_error(best["metrics.F"], best["metrics.F_se"])
    assert ["layout.offset", "0, 0.802, 0.1", "read off a figure"] in cells
    assert ["arm.joints.upper.a", "reach * split"] in cells
    seen.text(design["spec_hash"])
    seen.picture("note")


def test_the_best_trials_note_tells_its_design_and_numbers(dashboard, see, rows):
    from eiwa.cli.tables import with_error

    best = max(of_kind(rows, "leader"), key=lambda r: r["metrics.F"])
    seen = see(f"{dashboard.address}/trials?numbers={best['number']}")
    seen.text("2 replicates.")
    cells = seen.table()
    assert ["layout.spacing", f"{best['values.layout.spacing']:.6g}"] in cells
    pairs = [("metrics.F", "metrics.F_se"), ("metrics.F@dexterity.K=50", "metrics.F_se@dexterity.K=50")]
    assert ["F", *(with_error(best[value], best[error]) for value, error in pairs)] in cells
    seen.picture("trial")


# What it does not do


def test_nothing_can_be_changed(dashboard, see, study):
    """The note's own editor and a request to delete the study are refused."""
    before = content(study)
    seen = see(f"{dashboard.address}/note")
    seen.text("What the search chooses")
    seen.page.get_by_test_id("EditIcon").or_(seen.page.locator("h1 >> xpath=../.. >> button")).first.click()
    seen.page.locator("textarea").first.fill("gone")
    seen.page.get_by_role("button", name="Save").click()
    seen.text("only shows the study")
    seen.picture("refused")
    api = dashboard.address.replace("/dashboard", "/api")
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(urllib.request.Request(api, method="DELETE", data=b"{}"))
    assert content(study) == before


def content(folder):
    return {p: p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


# While the study runs, and at the end


def test_a_running_study_is_shown_as_it_goes_on(see, tmp_path):
    small.paused(tmp_path, 5000)
    run = small.start("study", "run", "small.toml", folder=tmp_path)
    try:
        trials = tmp_path / "runs/small/trials"
        while len(list(trials.glob("*.parquet"))) < 2:
            assert run.poll() is None, run.communicate()[1]
            time.sleep(0.1)
        with Dashboard(tmp_path) as dashboard:
            seen = see(dashboard.address)
            seen.text("Best Trial (number=")
            seen.page.wait_for_function(f"{COUNT} > 0")
            first = seen.page.evaluate(COUNT)
            seen.page.wait_for_function(f"{COUNT} > {first}")
            assert seen.errors == []
        assert run.poll() is None
    finally:
        run.kill()
        run.communicate()


def test_a_folder_that_can_only_be_read_is_enough_and_ctrl_c_ends_it(study, tmp_path):
    """Files are the same before and after."""
    shutil.copytree(study, tmp_path / "copy")
    for path in [*(tmp_path / "copy").rglob("*"), tmp_path / "copy"]:
        path.chmod(0o555 if path.is_dir() else 0o444)
    before = content(tmp_path / "copy")
    with Dashboard(tmp_path / "copy") as dashboard:
        with urllib.request.urlopen(dashboard.address) as answer:
            assert answer.status == 200
        dashboard.process.send_signal(signal.SIGINT)
        out, err = dashboard.process.communicate(timeout=120)
        assert (dashboard.process.returncode, out, err) == (0, "", "")
    assert content(tmp_path / "copy") == before


# What it refuses


def test_a_port_in_use(dashboard, study, cli, monkeypatch):  # noqa: F811
    monkeypatch.chdir(study)
    port = dashboard.address.split(":")[2].split("/")[0]
    said = cli("study", "dashboard", "small.toml", "--port", port)
    assert (said.code, said.out) == (2, "")
    assert said.err == f"--port {port}: is in use; choose another with --port; 0 takes a free one\n"


def test_a_study_without_results(cli, tmp_path, monkeypatch):  # noqa: F811
    monkeypatch.chdir(tmp_path)
    small.write(tmp_path)
    said = cli("study", "dashboard", "small.toml")
    assert (said.code, said.out) == (2, "")
    assert "runs/small: has no results yet. Run: eiwa study run small.toml" in said.err


def test_results_of_another_study_file(study, cli, monkeypatch):  # noqa: F811
    monkeypatch.chdir(study)
    said = cli("study", "dashboard", "small.toml", "--set", "layout.spacing=0.3")
    assert said.code == 2
    assert "layout.spacing: 0.2 -> 0.3" in said.err


def test_without_optuna_dashboard(study, cli, monkeypatch):  # noqa: F811
    monkeypatch.chdir(study)
    monkeypatch.setitem(__import__("sys").modules, "optuna_dashboard", None)
    said = cli("study", "dashboard", "small.toml")
    assert said.code == 2
    assert "pip install 'eiwa[dashboard]'" in said.err
