"""A study as plain bytes for another process, folder or machine: its tree, and the content of the files that it names."""

from __future__ import annotations

import pickle
import platform
import tempfile
from collections.abc import Mapping
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path

from eiwa.core import version as eiwa
from eiwa.core.errors import ExecutionError
from eiwa.core.spec import StudySpec, check


def packed(spec: StudySpec) -> bytes:
    """What :func:`unpacked` needs; where the study runs and is stored stays behind."""
    files = {name: (str(path.resolve()), path.read_bytes()) for name, path in spec.registry.located.items()}
    tree = {table: value for table, value in spec.tree.items() if table != "execution"}
    return pickle.dumps(
        {"versions": _versions(), "hash": spec.hash, "path": str(spec.path), "tree": tree, "files": files}
    )


@lru_cache(maxsize=4)
def unpacked(parcel: bytes) -> StudySpec:
    """The study of a parcel.

    Raises
    ------
    ExecutionError
        This process has other versions of what the numbers depend on, or reads another study.
    """
    content = pickle.loads(parcel)
    for name, wanted in content["versions"].items():
        if (found := _versions()[name]) != wanted:
            raise ExecutionError(
                f"A worker on {platform.node()} has {name} {found}, the process that runs the study has {wanted}: "
                "their numbers could differ. Install the same versions for both."
            )
    located = _located(content["files"])
    spec = check(content["tree"], Path(content["path"]), located)
    if spec.hash != content["hash"]:
        raise ExecutionError(
            f"A worker on {platform.node()} reads another study ({spec.hash}) than the process that runs it "
            f"({content['hash']}): a file that the study names was changed meanwhile, or an installed plugin differs."
        )
    return spec


def _versions() -> Mapping[str, str]:
    return {"eiwa": eiwa.__version__, **{name: version(name) for name in ("numpy", "scipy", "numba")}}


_folder: list[tempfile.TemporaryDirectory[str]] = []
"""Where this process keeps files that it was sent, to its end."""


def _located(files: Mapping[str, tuple[str, bytes]]) -> dict[str, Path]:
    """Every file at its own place where it lies there unchanged, else as a copy that bears its name."""
    located = {}
    for number, (name, (original, content)) in enumerate(files.items()):
        path = Path(original)
        if not (path.is_file() and path.read_bytes() == content):
            if not _folder:
                _folder.append(tempfile.TemporaryDirectory(prefix="eiwa-"))
            path = Path(tempfile.mkdtemp(prefix=f"{number}-", dir=_folder[0].name)) / path.name
            path.write_bytes(content)
        located[name] = path
    return located
