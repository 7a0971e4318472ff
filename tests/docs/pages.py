"""The pages a reader sees, and the parts of them that can be checked."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]
NAMES = [page.name for page in PAGES]
# Made when the site is built, by tools/docs_hooks.py: what a link names, and the file that it becomes.
GENERATED = {
    "changelog.md": ROOT / "CHANGELOG.md",
    **{f"schemas/{path.name}": path for path in (ROOT / "src/screwpose/files/schemas").glob("*.schema.json")},
}

_FENCE = re.compile(r"^(?P<indent> *)```(?P<language>\w*)\n(?P<body>.*?)^(?P=indent)```$", re.M | re.S)


class Typed(NamedTuple):
    """The words of a command line, and whether a block tells a reader to type it as it stands."""

    words: list[str]
    whole: bool


class Block(NamedTuple):
    """A fenced block: its language, its text, and the line on which its text begins."""

    language: str
    text: str
    line: int


def blocks(text: str, *languages: str) -> list[Block]:
    """The fenced blocks of a page in these languages, in order."""
    return [
        Block(match["language"], match["body"], text[: match.start("body")].count("\n") + 1)
        for match in _FENCE.finditer(text)
        if match["language"] in languages
    ]


def prose(text: str) -> str:
    """A page without its fenced blocks."""
    return _FENCE.sub("", text)


def code_spans(text: str) -> list[str]:
    """What stands in single backticks in the prose; a line's end in one is a space."""
    return [" ".join(span.split()) for span in re.findall(r"(?<!`)`([^`]+)`(?!`)", prose(text))]


def command_lines(text: str) -> Iterator[Typed]:
    """Every command line of a page: in blocks of sh, and in code spans, which may name a command alone."""
    typed = [(line, True) for block in blocks(text, "sh") for line in block.text.splitlines()]
    for line, whole in typed + [(span, False) for span in code_spans(text) if " " in span]:
        words = shlex.split(line, comments=True)
        if words:
            yield Typed(words, whole)


def links(text: str) -> list[str]:
    """The targets of all links and images in the prose, but those in code spans."""
    without_code = re.sub(r"(?<!`)`[^`]+`(?!`)", "", prose(text))
    return re.findall(r"\]\(([^)\s]+)\)", without_code)
