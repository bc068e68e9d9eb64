"""Writes the tables of the reference from eiwa's models, those of the performance page from the last results of
`eiwa bench`, and checks that hand-written pages name everything there is."""

import inspect
import json
import os
import re
import shutil
from pathlib import Path

from eiwa.core import hookspecs, sections
from eiwa.core.description import tables
from eiwa.core.registry import KINDS, load

EXAMPLE = Path(__file__).parent.parent / "studies" / "paper.toml"
RESULTS = Path(__file__).parent.parent / "benchmarks" / "results"
SECTIONS = {
    "study": sections.StudySection,
    "layout": sections.LayoutSection,
    "operator": sections.OperatorSection,
    "dexterity": sections.DexteritySection,
    "voxels": sections.VoxelsSection,
    "sampling": sections.SamplingSection,
    "range": sections.RangeSection,
    "objective": sections.ObjectiveSection,
    "constraint": sections.ConstraintSection,
}


def write(docs):
    """One Markdown file per table; a file that would not change is left alone, so that Sphinx need not read it again."""
    for folder, pages in (("reference", reference()), ("explanation", measured())):
        generated = docs / folder / "_generated"
        generated.mkdir(parents=True, exist_ok=True)
        for name, text in pages.items():
            path = generated / f"{name}.md"
            if not path.exists() or path.read_text() != text:
                path.write_text(text)
    for picture in RESULTS.glob("*.png"):
        shutil.copy2(picture, docs / "explanation" / "_generated")


def reference():
    """Tables of keys, plugins, numbers and commands."""
    pages = {name: table(tables(model)[0].keys) for name, model in SECTIONS.items()}
    for kind in KINDS:
        pages[f"plugins-{kind}"] = "\n".join(described(entry.plugin, kind) for entry in built_in(kind))
    pages["numbers"] = numbers()
    pages["commands"] = "\n".join(help_page(name) for name in listed())
    return pages


def measured():
    """Tables and pictures of every part of the results, and where they were measured."""
    from eiwa.bench.measure import read
    from eiwa.cli.bench import views

    records, where = read(RESULTS / "bench.parquet")
    pages = {}
    for what in dict.fromkeys(r.what for r in records):
        shown = views([r for r in records if r.what == what])
        tables = [f"**{view.title}**\n\n{texts(view.columns, view.rows)}" for view in shown]
        picture = f"```{{image}} _generated/{what}.png\n:alt: The times of the tables, drawn.\n```"
        pages[what] = "\n".join([*tables, picture, ""])
    vectors = next(
        (name for name in ("avx512f", "avx2", "neon") if name in where["features"].split()), "no known vectors"
    )
    visits = [r.visits for r in records if r.what == "compare" and r.visits]
    busy = max((r.others for r in records if r.others is not None), default=0.0)
    versions = ", ".join(f"{name} {version}" for name, version in json.loads(where["versions"]).items())
    pages["machine"] = (
        f"Measured on {where['started']:%d %B %Y}: processor {where['cpu']} ({vectors}), {max(r.threads for r in records)} "
        f"threads, {min(visits)} visits, {busy:.1f} cores busy with other processes; {versions}.\n"
    )
    return pages


def texts(columns, rows):
    """Rows of texts as a Markdown table, the first column to the left."""
    heads = [column.replace("\n", " ") for column in columns]
    lines = [heads, ["---", *["---:"] * (len(heads) - 1)], *rows]
    return "".join(f"| {' | '.join(map(literal, line))} |\n" for line in lines)


def missing(folder):
    """What the hand-written pages do not mention: hooks with their signature, columns of the store."""
    pages = {page: (folder / page).read_text() for page in ("plugins.md", "store.md")}
    wanted = [("store.md", f"`{name}`") for name in columns()]
    for hook in KINDS.values():
        result = inspect.signature(getattr(hookspecs, hook)).return_annotation
        wanted += [("plugins.md", f"### `{hook}`"), ("plugins.md", f"def {hook}() -> {result}")]
    return [f"docs/reference/{page} does not mention {word}" for page, word in wanted if word not in pages[page]]


def columns():
    """Columns of the store, with the parts that a study names left out."""
    from eiwa.core.spec import load as load_study
    from eiwa.study.rows import schema

    families = {"parameters": "V", "values": "PATH", "objectives": "I", "constraints": "I"}
    families |= {"metrics": "NAME", "replicated": "F"}
    heads = (name.split(".")[0] for name in schema(load_study(EXAMPLE)).names)
    return dict.fromkeys(f"{head}.{families[head]}" if head in families else head for head in heads)


def listed():
    """Every command line that there is, groups before their commands."""
    import typer

    from eiwa.cli import app

    def walk(command, name):
        yield name
        for key, child in sorted(getattr(command, "commands", {}).items()):
            yield from walk(child, f"{name} {key}")

    return list(walk(typer.main.get_command(app), "eiwa"))


def help_page(command):
    """A heading and what ``eiwa COMMAND --help`` prints."""
    from typer.testing import CliRunner

    from eiwa.cli import app

    os.environ["COLUMNS"] = "90"
    arguments = [*command.split()[1:], "--help"]
    result = CliRunner().invoke(app, arguments, prog_name="eiwa", env={"TERM": "dumb"})
    lines = [line.rstrip() for line in result.output.strip("\n").splitlines()]
    return "\n".join([f"## {command}", "", "```text", *lines, "```", ""])


def built_in(kind):
    """Entries of a kind that come with eiwa."""
    return [entry for entry in load().of_kind(kind) if entry.provider.startswith("eiwa.")]


def described(plugin, kind):
    """A plugin's heading, docstring and parameters."""
    level = "###" if kind == "metrics" else "####"
    whole, *inner = tables(plugin.parameters)
    parts = [f"{level} `{plugin.name}`", "", text_of(whole).replace("\n", "\n\n"), ""]
    if plugin.numbers:
        parts += ["Yields " + ", ".join(f"`{n.name}`" for n in plugin.numbers) + ".", ""]
    if whole.keys:
        parts += [table(whole.keys)]
    for part in inner:
        parts += [f"Each {part.name}: {text_of(part)}", "", table(part.keys)]
    return "\n".join(parts)


def text_of(described):
    """A model's docstring."""
    return literal(described.text.replace("``", "`"))


def numbers():
    """Every number that a metric yields."""
    lines = ["| number | metric | unit | what | bounds |", "|---|---|---|---|---|"]
    for plugin in (entry.plugin for entry in built_in("metrics")):
        for n in plugin.numbers:
            bounds = f"{n.low:g} to {n.high:g}".replace("-inf to inf", "").replace("to inf", "or more")
            lines.append(f"| `{n.name}` | `{plugin.name}` | {n.unit or '1'} | {literal(n.description)} | {bounds} |")
    return "\n".join(lines) + "\n"


def table(keys):
    """Keys of a model as a Markdown table; the source column only where a key names one."""
    sourced = any(key.source for key in keys)
    head = ["key", "type", "default", "unit", "what", *(["source of the default"] if sourced else [])]
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for key in keys:
        default = key.default if key.required or key.default == "none" else f"`{key.default}`"
        kind = re.sub(r'("[^"]*"|\^\S+)', r"`\1`", key.type)
        cells = [f"`{key.name}`", kind, default, key.unit, literal(key.what)]
        lines.append(f"| {' | '.join([*cells, *([literal(key.source)] if sourced else [])])} |")
    return "\n".join(lines) + "\n"


def literal(text):
    """Text in which Markdown sees no markup."""
    return text.replace("|", "\\|").replace("_", "\\_").replace("<", "\\<").replace("*", "\\*").replace("$", "\\$")
