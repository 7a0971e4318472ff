"""The reference page of the command line, made from the commands themselves.

``python -m screwpose.cli.reference [FILE]`` writes it, by default to ``docs/cli.md`` below the current folder; a test
holds that the page that is kept there is what the commands say.
"""

import sys
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import Any, get_args, get_origin

import typer.main

from screwpose.cli.commands import app
from screwpose.files.atomic import write_text

_HEAD = """\
# Command line

This page is made by `python -m screwpose.cli.reference` from the program itself.

{help}

```text
{name} --version
{name} --help
{name} COMMAND --help
```

{epilog} [Errors](errors.md) says more.
"""


def reference_page() -> str:
    """The page as Markdown."""
    root: Any = typer.main.get_command(app)
    page = _HEAD.format(name=root.name, help=root.help, epilog=root.epilog)
    return page + "".join(_section(path, command) for path, command in _leaves(root.name, root))


def _leaves(path: str, command: Any) -> Iterator[tuple[str, Any]]:
    """Every command that is no group, by its words: ``screwpose model inspect``."""
    for name, below in command.commands.items():
        if hasattr(below, "commands"):
            yield from _leaves(f"{path} {name}", below)
        else:
            yield f"{path} {name}", below


def _section(path: str, command: Any) -> str:
    arguments = [one for one in command.params if one.param_type_name == "argument"]
    options = [one for one in command.params if one.param_type_name == "option"]
    words = [one.name.upper() if one.required else f"[{one.name.upper()}]" for one in arguments]
    words += [f"{one.opts[0]} {_value(one)}".strip() for one in options if one.required]
    lines = [f"\n## {path}\n", f"{command.help}\n", f"```text\n{' '.join([path, *words, '[OPTIONS]'])}\n```\n"]
    lines += ["| | | default |", "| :--- | :--- | :--- |"]
    lines += [f"| `{one.name.upper()}` | {one.help} | {'required' if one.required else ''} |" for one in arguments]
    lines += [f"| {_spelling(one)} | {one.help} | {_default(one)} |" for one in options]
    return "\n".join(lines) + "\n"


def _spelling(option: Any) -> str:
    names = ", ".join(f"`{name}`" for name in sorted(option.opts, key=len))
    value = _value(option)
    return f"{names} {value}" if value else names


def _value(option: Any) -> str:
    """What follows the option: the choices, or the kind of value with its bounds; nothing for a switch."""
    kind, info = option.type_descriptor.annotation, option.type_descriptor.parameter_info
    if kind is bool:
        return ""
    if isinstance(kind, type) and issubclass(kind, Enum):
        return " or ".join(str(choice.value) for choice in kind)
    if get_origin(kind) is tuple:
        return " ".join("NUMBER" for _ in get_args(kind))
    name = {"int": "INTEGER", "float": "NUMBER", "str": "TEXT"}.get(getattr(kind, "__name__", ""), "PATH")
    if info.min is not None and info.max is not None:
        return f"{name} {info.min:g} to {info.max:g}"
    return name if info.min is None else f"{name} from {info.min:g}"


def _default(option: Any) -> str:
    if option.required:
        return "required"
    default = option.default.value if isinstance(option.default, Enum) else option.default
    return "" if default is None or default is False else f"`{default}`"


if __name__ == "__main__":
    write_text(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/cli.md"), reference_page())
