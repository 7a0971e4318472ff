"""``python -m screwpose``."""

from screwpose.cli import main

main()
