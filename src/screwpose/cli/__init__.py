"""The front door: the program `screwpose`. (floor 8)"""

from screwpose.cli.commands import app, main

__all__ = ["app", "main"]
