"""Named designs that replace whole tables: from another file, or written in the design."""

import json

import pytest

from eiwa.core.errors import SpecError
from eiwa.core.spec import check, load
from tests import arms, urdf
from tests.study import small

SHORT = small.JOINTS.replace("a = 0.26", "a = 0.15").replace("a = 0.18", "a = 0.12")
ARM = f'[arm]\nkind = "dh"\nconvention = "modified"\n{SHORT}'
"""The small study's arm with shorter links: the same kernel."""
RANKED = {**small.NO_SEARCH, small.DESIGN: '[designs.here]\n\n[designs.short]\nfrom = "devices/short.toml"\n'}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "devices").mkdir()
    (tmp_path / "devices" / "short.toml").write_text(ARM)
    return tmp_path


def study(folder, design, changes=None):
    return load(small.write(folder, small.NO_SEARCH | {small.DESIGN: f"[designs.short]\n{design}\n"} | (changes or {})))


def arm_of(spec, name="short"):
    return spec.design(spec.designs[name].overrides).resolved()["arm"]


FROM = 'from = "devices/short.toml"'


def test_a_design_takes_a_table_from_a_file(folder):
    spec = study(folder, FROM)
    assert [j["a"] for j in arm_of(spec)["joints"]] == [0, 0, 0.15, 0.12, 0, 0]
    assert [j["a"] for j in spec.design({}).resolved()["arm"]["joints"]] == [0, 0, 0.26, 0.18, 0, 0]


def test_paths_lead_into_the_new_table(folder):
    assert arm_of(study(folder, f'{FROM}\n"arm.joints.fore.a" = 0.2'))["joints"][3]["a"] == 0.2


def test_a_path_to_a_default_of_the_new_table(folder):
    """A URDF's scale is written nowhere, neither in the study nor in the file."""
    (folder / "devices" / "mtm.urdf").write_text(urdf.from_table(arms.mtm_table()))
    (folder / "devices" / "mtm.toml").write_text('[arm]\nkind = "urdf"\nfile = "mtm.urdf"\n')
    spec = study(folder, 'from = "devices/mtm.toml"\n"arm.scale.j1_turned" = 1.5')
    assert (arm_of(spec)["scale"]["j1_turned"], arm_of(spec)["scale"]["base"]) == (1.5, 1.0)


def test_a_design_writes_a_table_itself(folder):
    inline = 'arm = { kind = "delta", base_radius = 0.1, platform_radius = 0.05, upper = 0.2, lower = 0.3, '
    spec = study(folder, f'{inline}limits = [0, 90], slope = [20, 80] }}\n"dexterity.rows" = "translation"')
    assert (arm_of(spec)["kind"], arm_of(spec)["tool"]) == ("delta", [0.0, 0.0, 0.0])


def test_a_file_may_hold_several_tables(folder):
    (folder / "devices" / "short.toml").write_text(f"{ARM}\n[layout]\nspacing = 0.5\noffset = [0.0, 0.6, 0.0]\n")
    resolved = study(folder, FROM).design(study(folder, FROM).designs["short"].overrides).resolved()
    assert (resolved["layout"]["spacing"], resolved["layout"]["orientation"]) == (0.5, [0.0, 0.0, 0.0])


def test_scenarios_come_on_top(folder):
    spec = study(folder, FROM, {small.TOP: f"{small.SCENARIOS}\n{small.TOP}"})
    overrides = {**spec.designs["short"].overrides, **spec.scenarios[1].overrides}
    resolved = spec.design(overrides).resolved()
    assert (resolved["dexterity"]["K"], resolved["arm"]["joints"][2]["a"]) == (50, 0.15)


def test_a_study_file_that_writes_everything_out_is_the_same(folder):
    spec = study(folder, FROM)
    tree = {**spec.tree, "designs": {"short": {"arm": spec.designs["short"].overrides["arm"]}}}
    assert check(tree, spec.path).designs["short"] == spec.designs["short"]


def test_files_are_named_from_the_file_that_names_them_and_known_by_content(folder):
    (folder / "devices" / "mtm.urdf").write_text(urdf.from_table(arms.mtm_table()))
    (folder / "devices" / "mtm.toml").write_text('[arm]\nkind = "urdf"\nfile = "mtm.urdf"\n')
    file = study(folder, 'from = "devices/mtm.toml"').designs["short"].overrides["arm"]["file"]
    assert file.startswith("devices/mtm.urdf sha256:")


def test_a_file_that_changes_after_loading_is_told(folder):
    (folder / "arm.urdf").write_text(urdf.from_table(arms.mtm_table()))
    spec = study(folder, 'arm = { kind = "urdf", file = "arm.urdf" }')
    (folder / "arm.urdf").write_text(urdf.from_table(arms.panda_table()))
    with pytest.raises(SpecError, match=r"arm\.file = .*the file has changed"):
        spec.design(spec.designs["short"].overrides)


REFUSED = {
    "a missing file": ('from = "none.toml"', "designs.short.from = 'none.toml'", "cannot be read (no such file"),
    "a number for a file": ("from = 3", "designs.short.from = 3", "must be the name of a TOML file"),
    "what is not TOML": ('from = "broken.toml"', "designs.short.from = 'broken.toml'", "is not TOML"),
    "a table that is none": ('from = "armm.toml"', "designs.short.from", "has 'armm'; did you mean 'arm'?"),
    "an arm that cannot be": ('from = "bad.toml"', "designs.short: arm.kind = 'dhh'", "did you mean 'dh'?"),
    "a path that the new arm does not have": (
        f'{FROM}\n"arm.scale.base" = 1.0', 'designs.short."arm.scale.base"', "arm has no 'scale'"),
    "a table without a kind": ("layout = { spacing = 0.3 }", "designs.short.layout", "Quote the whole path"),
}  # fmt: skip


@pytest.mark.parametrize(("design", "path", "words"), REFUSED.values(), ids=REFUSED)
def test_a_design_that_cannot_be_is_refused(folder, design, path, words):
    (folder / "broken.toml").write_text("[arm")
    (folder / "armm.toml").write_text("[armm]")
    (folder / "bad.toml").write_text('[arm]\nkind = "dhh"\n')
    with pytest.raises(SpecError) as error:
        study(folder, design)
    assert any(line.startswith(path) and words in line for line in error.value.findings), error.value.findings


# Run


def run(folder):
    spec = load(small.write(folder, RANKED))
    store = small.run(spec, folder / "runs")
    return {r["name"]: r for r in store.rows()}, len(store.rows()), spec


def test_a_row_keeps_the_table_that_made_it(folder):
    rows, _, _ = run(folder)
    assert json.loads(rows["short"]["overrides"])["arm"]["joints"][2]["a"] == 0.15
    assert rows["here"]["metrics.F"] != rows["short"]["metrics.F"]


def test_a_table_that_changes_is_evaluated_again(folder):
    run(folder)
    assert run(folder)[1] == 2
    (folder / "devices" / "short.toml").write_text(ARM.replace("0.12", "0.13"))
    assert run(folder)[1] == 3
