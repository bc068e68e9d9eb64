"""``python -m eiwa``."""

from eiwa.cli import main

main()
