"""What ``eiwa plugins new`` writes: a working plugin, and around it a study or a package."""

from __future__ import annotations

import keyword
from importlib.resources import files
from pathlib import Path

from eiwa.core.errors import PluginError, SpecError
from eiwa.core.registry import KINDS, load
from eiwa.core.tree import did_you_mean
from eiwa.core.version import __version__

Files = dict[Path, str]


def new(kind: str, name: str, folder: Path, *, package: bool, study: bool) -> list[Path]:
    """Write a plugin of a kind, and return what was written.

    Raises
    ------
    SpecError
        No such kind; a name that is none; a file that exists already.
    PluginError
        The name is taken.
    """
    if kind not in KINDS:
        raise SpecError(f"{kind}: no such kind of plugin{did_you_mean(kind, KINDS)}")
    if keyword.iskeyword(name):
        raise SpecError(f"{name}: is a word of Python's and cannot name a module. Choose another name.")
    if not (name.isascii() and name.isidentifier() and name == name.lower()):
        raise SpecError(f"{name}: a plugin's name has lower-case letters, digits and _, and begins with a letter.")
    taken = load().entries.get((kind, name))
    if taken:
        raise PluginError(f"{name}: the {kind} plugin of this name is {taken.provider}'s. Choose another name.")
    written = packaged(kind, name) if package else {Path(f"{name}.py"): template(kind, name)}
    if study:
        written[Path(name if package else "") / f"{name}.toml"] = study_of(kind, name, package)
    there = [str(path) for path in written if (folder / path).exists()]
    if there:
        raise SpecError(f"{', '.join(there)}: exists, and is not overwritten. Choose another name, or move it away.")
    for path, text in written.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text, encoding="utf-8")
    return list(written)


def template(kind: str, name: str) -> str:
    """The working plugin of a kind under another name."""
    text = (files("eiwa.cli.templates") / f"{kind}.py").read_text(encoding="utf-8")
    return text.replace("Mydevice", name.title().replace("_", "")).replace("mydevice", name)


def packaged(kind: str, name: str) -> Files:
    """A project that installs the plugin: source, entry point, test, README."""
    project = name.replace("_", "-")
    root = Path(name)
    words = {"name": name, "project": project, "kind": kind, "version": __version__}
    return {
        root / "pyproject.toml": PYPROJECT.format(**words),
        root / "README.md": README.format(**words),
        root / "src" / name / "__init__.py": f'"""An eiwa plugin: {kind} {name}."""\n',
        root / "src" / name / "py.typed": "",
        root / "src" / name / "plugin.py": template(kind, name),
        root / "tests" / f"test_{name}.py": TEST.format(**words),
    }


def study_of(kind: str, name: str, installed: bool) -> str:
    """A small study that uses the plugin: every table of a study file, the plugin's own with its defaults."""
    tables = {**TABLES, "dexterity": THREE_JOINTS} if kind == "arm" else dict(TABLES)
    tables[kind] = f'kind = "{name}"' if kind != "metrics" else ""
    if kind in OWN:
        tables[kind] += f"\n{OWN[kind]}"
    heads = {key: f"metrics.{name}" if key == "metrics" else key for key in tables if key != "metrics" or kind == key}
    body = [f"[{head}]\n{tables[key]}".rstrip() for key, head in heads.items()]
    found = "" if installed else f'plugins = ["{name}.py"] # beside this file\n\n'
    return f"{found}{STUDY.format(name=name)}\n" + "\n\n".join(body) + f"\n\n{SEARCH}"


PYPROJECT = """[build-system]
requires = ["hatchling"]
build-backend = "hatchling.build"

[project]
name = "{project}"
version = "0.1.0"
description = "An eiwa plugin: {kind} {name}"
readme = "README.md"
requires-python = ">=3.11"
dependencies = ["eiwa>={version}"]

[project.optional-dependencies]
test = ["pytest"]

[project.entry-points.eiwa]
{name} = "{name}.plugin"

[tool.hatch.build.targets.wheel]
packages = ["src/{name}"]
"""

README = """# {project}

An eiwa plugin: {kind} `{name}`.

```console
$ pip install -e ".[test]"
$ eiwa plugins show {name}
$ eiwa plugins check {name}
$ pytest
```
"""

TEST = '''"""The plugin keeps eiwa's contracts; ``eiwa plugins check {name}`` runs the same."""

import pytest
from eiwa import testing

from {name} import plugin

SUBJECT = testing.subject(plugin)


@pytest.mark.parametrize("contract", testing.contracts("{kind}"))
def test_contract(contract):
    contract(SUBJECT)
'''

STUDY = """[study]
name = "{name}"
trials = 16
sampler = "qmc"
"""

TABLES = {
    "arm": """kind = "dh"
convention = "modified"
joints = [
  { name = "waist", limits = [-120, 120] },
  { name = "shoulder", alpha = 90, limits = [-120, 120] },
  { name = "upper", alpha = -90, a = 0.26, limits = [-120, 120] },
  { name = "fore", a = 0.18, limits = [-120, 120] },
  { name = "pitch", alpha = -90, limits = [-120, 120] },
  { name = "roll", alpha = 90, limits = [-120, 120] },
]""",
    "layout": """spacing = 0.3
offset = [0.0, 0.75, 0.05]
orientation = [0, 0, -90] # base z up, base x towards the operator""",
    "human": 'kind = "ehem"\nsamples = 262_144',
    "dexterity": 'kind = "yoshikawa"\nK_scaled = 3 # a factor of 0.95 at mid-range',
    "voxels": "size = 0.02",
    "sampling": "samples = 262_144",
    "metrics": "",
}
THREE_JOINTS = TABLES["dexterity"] + '\nrows = "translation" # fewer than six joints cannot move in all six directions'
OWN = {"voxels": 'size = 0.02\naggregate = "share"'}
"""Keys that stand in the plugin's table, too."""

SEARCH = """[search]
"layout.spacing" = { low = 0.2, high = 0.6 }
"layout.offset.1" = { low = 0.6, high = 0.9 }

[[objectives]]
metric = "F"
direction = "maximize"
"""
