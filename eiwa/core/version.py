"""The installed version."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("eiwa")
except PackageNotFoundError:
    __version__ = "0+source"
