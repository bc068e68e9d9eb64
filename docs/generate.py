"""Writes the tables of the reference from eiwa's models, those of the performance page from the last results of
`eiwa bench`, and checks that hand-written pages name everything there is."""

import inspect
import json
import os
import re
import shutil
from pathlib import Path

from eiwa import testing
from eiwa.core import hookspecs, manufacture, objectives, sections
from eiwa.core.description import tables, toml
from eiwa.core.errors import EiwaError
from eiwa.core.registry import KINDS, load
from eiwa.core.samplers import SAMPLERS
from eiwa.testing.subject import of_entry

EXAMPLE = Path(__file__).parent.parent / "studies" / "paper.toml"
RESULTS = Path(__file__).parent.parent / "benchmarks" / "results"
SECTIONS = {
    "study": sections.StudySection,
    "execution": sections.ExecutionSection,
    "layout": sections.LayoutSection,
    "operator": sections.OperatorSection,
    "dexterity": sections.DexteritySection,
    "voxels": sections.VoxelsSection,
    "sampling": sections.SamplingSection,
    "adjust": sections.AdjustSection,
    "grid": sections.GridSection,
    "range": sections.RangeSection,
    "objective": objectives.ObjectiveSection,
    "constraint": objectives.ConstraintSection,
    "tolerance": manufacture.ToleranceSection,
}


def write(docs):
    """One Markdown file per table, and one page per built-in."""
    built_ins = {f"{e.kind}-{e.plugin.name}": page(e) for kind in KINDS for e in built_in(kind)}
    put(docs / "reference" / "_generated", reference())
    put(docs / "reference" / "built-in", built_ins)
    put(docs / "explanation" / "_generated", measured())
    for picture in RESULTS.glob("*.png"):
        shutil.copy2(picture, docs / "explanation" / "_generated")


def put(folder, pages):
    """Write pages by name; a file that would not change is left alone, so that Sphinx need not read it again."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in folder.glob("*.md"):
        if path.stem not in pages:
            path.unlink()
    for name, text in pages.items():
        path = folder / f"{name}.md"
        if not path.exists() or path.read_text() != text:
            path.write_text(text)


def reference():
    """Tables of keys, plugins, numbers and commands."""
    pages = {name: table(tables(model)[0].keys) for name, model in SECTIONS.items()}
    for kind in KINDS:
        pages[f"built-in-{kind}"] = index(kind)
        pages[f"contracts-{kind}"] = contracts(kind)
    pages["numbers"] = numbers()
    pages["samplers"] = "\n".join(sampler(model) for model in SAMPLERS.values())
    pages["commands"] = "\n".join(help_page(name) for name in listed())
    return pages


def sampler(model):
    """A sampler's heading, what it is, its options."""
    (whole,) = tables(model)
    kind, *options = whole.keys
    return f"### {kind.default.strip(chr(34))}\n\n{text_of(whole)}\n\n{table(options) if options else ''}"


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
    """What the hand-written pages do not mention: hooks with their signature and an example, columns of the store."""
    wanted = [("store.md", f"`{name}`") for name in columns()]
    for kind, hook in KINDS.items():
        result, page = inspect.signature(getattr(hookspecs, hook)).return_annotation, f"plugins/{kind}.md"
        wanted += [
            (page, f"def {hook}() -> {result}"),
            (page, "{literalinclude} ../../examples/"),
            ("plugins.md", page),
        ]
        wanted += [(page, f"_generated/contracts-{kind}.md"), (page, f"_generated/built-in-{kind}.md")]
    pages = {page: (folder / page).read_text() if (folder / page).exists() else "" for page, _ in wanted}
    return [f"docs/reference/{page} does not mention {word}" for page, word in wanted if word not in pages[page]]


def columns():
    """Columns of the store, with the parts that a study names left out."""
    from eiwa.core.spec import load as load_study
    from eiwa.study.rows import schema

    families = {"parameters": "V", "values": "PATH", "objectives": "I", "constraints": "I"}
    families |= {"metrics": "NAME", "adjusted": "WHAT", "replicated": "metrics.NAME"}
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


def index(kind):
    """The built-ins of a kind, each with its page."""
    lines = ["| name | what it is |", "|---|---|"]
    for e in built_in(kind):
        lines.append(
            f"| [`{e.plugin.name}`](/reference/built-in/{kind}-{e.plugin.name}.md) | {literal(e.plugin.summary)} |"
        )
    return "\n".join(lines) + "\n"


def page(entry):
    """A built-in's docstring, parameters, numbers, and a table to begin with."""
    plugin, kind = entry.plugin, entry.kind
    whole, *inner = tables(plugin.parameters)
    where = f"metrics.{plugin.name}" if kind == "metrics" else kind
    parts = [f"# {plugin.name} ({kind})", "", text_of(whole).replace("\n", "\n\n"), ""]
    parts += [
        f"Table `[{where}]`, from `{entry.provider}`; see [its kind](../plugins/{kind}.md).",
        "",
        "## Parameters",
        "",
    ]
    parts += [table(whole.keys) if whole.keys else "None.", ""]
    for part in inner:
        parts += [f"Each {part.name}: {text_of(part)}", "", table(part.keys)]
    if plugin.numbers:
        parts += ["## Numbers", "", numbers_of([plugin])]
    if begun := beginning(entry):
        parts += ["## A table to begin with", "", "```toml", f"[{where}]", *begun, "```", ""]
    return "\n".join(parts)


def beginning(entry):
    """Lines of a valid table: required keys and examples; none where a file is needed."""
    try:
        given = of_entry(entry, {}).parameters.model_dump(mode="json", exclude_unset=True)
    except EiwaError:
        return []
    kind = [] if entry.kind == "metrics" else [f'kind = "{entry.plugin.name}"']
    return kind + [line for key, value in given.items() for line in lines_of(key, value)]


def lines_of(key, value):
    """A key as TOML writes it; a list of tables with one table a line."""
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return [f"{key} = [", *(f"  {toml(item)}," for item in value), "]"]
    return [f"{key} = {toml(value)}"]


def contracts(kind):
    """What eiwa.testing asks of a kind."""
    lines = ["| contract | what is asked |", "|---|---|"]
    for contract in testing.contracts(kind):
        promise = contract.__doc__.split("\n")[0]
        lines.append(f"| {testing.name_of(contract)} | {literal(promise)} |")
    return "\n".join(lines) + "\n"


def text_of(described):
    """A model's docstring."""
    return literal(described.text.replace("``", "`"))


def numbers():
    """Every number that a metric yields."""
    return numbers_of([entry.plugin for entry in built_in("metrics")])


def numbers_of(plugins):
    """The numbers of some metrics."""
    lines = ["| number | metric | unit | what | bounds |", "|---|---|---|---|---|"]
    for plugin in plugins:
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
