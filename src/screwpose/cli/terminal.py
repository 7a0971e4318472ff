"""How the command line talks: progress, errors, numbers for machines. One place for all commands."""

import json
import re
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Any, ParamSpec

import typer

from screwpose.errors import CancelledError, InputError, OutputError, ScrewposeError

P = ParamSpec("P")

OK, UNFORESEEN, USAGE, BAD_INPUT, CANNOT_WRITE, REFUSED, WORSE, INTERRUPTED = 0, 1, 2, 3, 4, 5, 6, 130

EXIT_CODES = (
    "Exit codes: 0 done (the answer's status is in result.json); 1 unforeseen, a bug; 2 the command line is wrong; "
    "3 the input is wrong; 4 the output cannot be written; 5 refused: no answer, and the result says why; "
    "6 worse than the baseline; 130 interrupted."
)

Progress = Callable[[float, str], None]


def exit_code_of(error: ScrewposeError) -> int:
    """The exit code that an error of ours ends the program with."""
    if isinstance(error, OutputError):
        return CANNOT_WRITE
    return INTERRUPTED if isinstance(error, CancelledError) else BAD_INPUT


def answers_errors(command: Callable[P, None]) -> Callable[P, None]:
    """Wrap a command: what goes wrong becomes one message and an exit code, here and nowhere else.

    With ``--json`` the message is one JSON object on standard output.
    """

    @wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        try:
            command(*args, **kwargs)
        except KeyboardInterrupt:
            typer.echo("screwpose: interrupted; nothing half-written was left", err=True)
            raise typer.Exit(INTERRUPTED) from None
        except ScrewposeError as error:
            if kwargs.get("as_json"):
                told = error.as_dict() if isinstance(error, InputError) else {}
                say_json({"error": type(error).__name__, "message": str(error), **told})
            else:
                typer.secho("screwpose: ", fg="red", bold=True, err=True, nl=False)
                typer.echo(plain(str(error)), err=True)
            raise typer.Exit(exit_code_of(error)) from None

    return run


# What a terminal obeys or lets run backwards: control characters, line and paragraph separators, direction marks.
_UNPRINTABLE = re.compile("[\x00-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]")
_LONGEST_WORD = 300
_WIDEST = 100


def plain(text: str) -> str:
    """Words from files, on one line and harmless: a label may hold anything, and a terminal would obey it."""
    shown = _UNPRINTABLE.sub(lambda found: found[0].encode("unicode_escape").decode(), text)
    return re.sub(rf"(\S{{{_LONGEST_WORD - 3}}})\S{{4,}}", r"\1...", shown)


def paragraph(text: str, indent: str = "  ") -> str:
    """A sentence as wide as the terminal, 80 columns where there is none; further lines are indented."""
    width = max(40, min(shutil.get_terminal_size((80, 24)).columns, _WIDEST))
    return textwrap.fill(plain(text), width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def say_json(data: dict[str, Any]) -> None:
    """One JSON object on standard output."""
    typer.echo(json.dumps(data, ensure_ascii=False, allow_nan=False, indent=2))


@contextmanager
def shown_progress(is_silent: bool) -> Iterator[Progress]:
    """A progress for the library to call: a bar on a terminal, a line for every tenth elsewhere, nothing if silent."""
    if is_silent:
        yield lambda _fraction, _what: None
    elif sys.stderr.isatty():
        with _bar() as progress:
            yield progress
    else:
        yield _Lines()


@contextmanager
def _bar() -> Iterator[Progress]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        BarColumn(30),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("{task.description}"),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=1.0)
        # The words are a file's or a label's: not rich's markup.
        yield lambda fraction, what: bar.update(task, completed=fraction, description=plain(what).replace("[", r"\["))


class _Lines:
    """Progress where there is no terminal: one line whenever another tenth of the work has begun."""

    def __init__(self) -> None:
        self._tenths = -1

    def __call__(self, fraction: float, what: str) -> None:
        tenths = int(fraction * 10)
        if tenths != self._tenths:
            self._tenths = tenths
            typer.echo(plain(f"{fraction:4.0%}  {what}"), err=True)
