"""Runs a page of the docs: files and changes are written, commands run, what they print is compared with the page."""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

BLOCK = re.compile(r"^```([^\n]+)\n((?::\w+:[^\n]*\n)*)(.*?)^```$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Block:
    """A fenced block: language or directive, caption, text."""

    head: str
    caption: str
    body: str


def blocks(page):
    """The fenced blocks of a page."""
    for head, options, body in BLOCK.findall(page.read_text()):
        caption = re.search(r":caption: (.*)", options)
        yield Block(head.strip(), caption[1].strip() if caption else "", body.strip("\n"))


def commands(block):
    """The commands of a console block, each with what the page says that it prints."""
    for part in re.split(r"^\$ ", block.body, flags=re.MULTILINE)[1:]:
        line, _, printed = part.partition("\n")
        yield shlex.split(line.split("  #")[0]), printed.rstrip("\n")


def changed(text, diff):
    """A text with every group of lines (- goes, + comes, the others stay) replaced; blank lines part the groups."""
    for group in diff.split("\n\n"):
        lines = group.strip("\n").split("\n")
        before = [line[1:] for line in lines if line[:1] in "- "]
        after = [line[1:] for line in lines if line[:1] in "+ "]
        if before != after:
            old, new = "\n".join(before), "\n".join(after)
            assert text.count(old) == 1, f"the page changes what is not there once: {old}"
            text = text.replace(old, new)
    return text


def alike(wanted, printed):
    """Whether a text is what the page says; '...' stands for anything, also over lines."""
    pattern = ".*".join(re.escape(part) for part in _trimmed(wanted).split("..."))
    return re.fullmatch(pattern, _trimmed(printed), re.DOTALL) is not None


def _trimmed(text):
    return "\n".join(line.rstrip() for line in text.strip("\n").split("\n"))


def run(page, cli):
    """Run a page in the current folder; the problems found."""
    problems = []
    for block in blocks(page):
        if block.head.startswith("{code-block}") and block.caption:
            path = Path(block.caption)
            path.write_text(changed(path.read_text(), block.body) if "diff" in block.head else f"{block.body}\n")
        elif block.head == "console":
            for command, wanted in commands(block):
                if command[0] == "eiwa" and (problem := _ran(command[1:], wanted, cli)):
                    problems.append(f"$ {shlex.join(command)}\n{problem}")
    return problems


def _ran(arguments, wanted, cli):
    """What is wrong with a command that the page runs: its output, or, where the page shows none, its failure."""
    words, _, file = (list(part) for part in partitioned(arguments, ">"))
    said = cli(*words)
    if file:
        Path(file[0]).write_text(said.out)
    if not wanted:
        return said.err if said.code else ""
    printed = said.err if said.code == 2 else said.out
    return "" if alike(wanted, printed) else f"{printed}\n--- the page says\n{wanted}"


def partitioned(items, mark):
    """What stands before a mark, the mark, what stands behind it."""
    place = items.index(mark) if mark in items else len(items)
    return items[:place], items[place : place + 1], items[place + 1 :]
