"""Writes the tables of the reference from eiwa's models, and checks that hand-written pages name everything there is."""

import inspect
import os
from pathlib import Path

from eiwa.core import hookspecs, sections
from eiwa.core.registry import KINDS, load

EXAMPLE = Path(__file__).parent.parent / "studies" / "paper.toml"
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


def write(folder):
    """One Markdown file per table; a file that would not change is left alone, so that Sphinx need not read it again."""
    folder.mkdir(parents=True, exist_ok=True)
    pages = {name: table(model.model_json_schema()) for name, model in SECTIONS.items()}
    for kind in KINDS:
        pages[f"plugins-{kind}"] = "\n".join(described(entry.plugin, kind) for entry in built_in(kind))
    pages["numbers"] = numbers()
    pages["commands"] = "\n".join(help_page(name) for name in listed())
    for name, text in pages.items():
        path = folder / f"{name}.md"
        if not path.exists() or path.read_text() != text:
            path.write_text(text)


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
    schema = plugin.parameters.model_json_schema()
    text = schema.get("description", "").replace("``", "`").replace("\n", "\n\n")
    parts = [f"{level} `{plugin.name}`", "", literal(text), ""]
    if plugin.numbers:
        parts += ["Yields " + ", ".join(f"`{n.name}`" for n in plugin.numbers) + ".", ""]
    if schema.get("properties"):
        parts += [table(schema)]
    for name, part in schema.get("$defs", {}).items():
        parts += [f"Each {name}: {literal(part['description'].replace('``', '`'))}", "", table(part)]
    return "\n".join(parts)


def numbers():
    """Every number that a metric yields."""
    lines = ["| number | metric | unit | what | bounds |", "|---|---|---|---|---|"]
    for plugin in (entry.plugin for entry in built_in("metrics")):
        for n in plugin.numbers:
            bounds = f"{n.low:g} to {n.high:g}".replace("-inf to inf", "").replace("to inf", "or more")
            lines.append(f"| `{n.name}` | `{plugin.name}` | {n.unit or '1'} | {literal(n.description)} | {bounds} |")
    return "\n".join(lines) + "\n"


def table(schema):
    """Keys of a model's JSON schema as a Markdown table; the source column only where a key names one."""
    keys = schema["properties"]
    sourced = any("source" in key for key in keys.values())
    head = ["key", "type", "default", "unit", "what", *(["source of the default"] if sourced else [])]
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for name, key in keys.items():
        default = "required" if name in schema.get("required", []) else value(key.get("default"))
        cells = [f"`{name}`", allowed(key), default, key.get("unit", ""), literal(key.get("description", ""))]
        lines.append(f"| {' | '.join([*cells, *([literal(key.get('source', ''))] if sourced else [])])} |")
    return "\n".join(lines) + "\n"


def allowed(key):
    """Type and bounds of one key."""
    if "anyOf" in key:
        return " or ".join(allowed(part) for part in key["anyOf"] if part.get("type") != "null")
    if "enum" in key or "const" in key:
        return ", ".join(f'`"{v}"`' for v in key.get("enum", [key.get("const")]))
    if "$ref" in key:
        return key["$ref"].split("/")[-1]
    if key["type"] == "object" and "additionalProperties" not in key:
        return "table"
    if key["type"] == "object":
        return f"table of name = {allowed(key['additionalProperties'])}"
    if key["type"] == "array":
        size = f"{key['minItems']} " if key.get("minItems") == key.get("maxItems", -1) else ""
        item = allowed(key["items"])
        return f"list of {size}{item + 's' if item.isalpha() else item}"
    if "pattern" in key:
        return f"string matching `{key['pattern']}`"
    signs = (("minimum", "≥"), ("exclusiveMinimum", ">"), ("maximum", "≤"), ("exclusiveMaximum", "<"))
    bounds = ", ".join(f"{sign} {key[bound]}" for bound, sign in signs if bound in key)
    return f"{key['type']} {bounds}".strip()


def value(default):
    """A default as TOML writes it."""
    if default is None:
        return "none"
    return f"`{str(default).lower() if isinstance(default, bool) else repr(default)}`".replace("'", '"')


def literal(text):
    """Text in which Markdown sees no markup."""
    return text.replace("|", "\\|").replace("_", "\\_").replace("<", "\\<").replace("*", "\\*").replace("$", "\\$")
