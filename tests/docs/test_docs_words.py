"""What the pages name exists: commands and options, make's targets, modules, numbers, links, files."""

import importlib
import re
import subprocess
import sys
import tomllib

import pytest
import typer.main

from screwpose.cli import app
from screwpose.cli.reference import reference_page
from tests.docs.pages import GENERATED, NAMES, PAGES, ROOT, blocks, code_spans, command_lines, links, prose

TEXTS = {page.name: page.read_text(encoding="utf-8") for page in PAGES}
EVERYTHING = "\n".join(TEXTS.values())
COMMAND = typer.main.get_command(app)
UsageError = next(c for c in typer.BadParameter.__mro__ if c.__name__ == "UsageError")


def parse(words, whole=True):
    """Parse a command line as the program would, and run nothing.

    `whole` is False where a command may be named alone, without what it needs.
    """
    if words[1:] == ["--help"]:
        return COMMAND
    context = COMMAND.make_context(words[0], list(words[1:]))
    left = [*context._protected_args, *context.args]
    command = COMMAND
    while left:
        _, command, left = command.resolve_command(context, left)
        if not left and not whole:
            return command
        context = command.make_context(command.name, list(left), parent=context)
        left = [*context._protected_args, *context.args] if hasattr(command, "commands") else []
    return command


def typed_commands(text):
    """The command lines of our program; ``screwpose COMMAND --help`` stands for all commands."""
    return [one for one in command_lines(text) if one.words[0] == "screwpose" and "COMMAND" not in one.words]


@pytest.mark.parametrize("name", NAMES)
def test_command_lines_parse(name):
    for words, whole in typed_commands(TEXTS[name]):
        parse(words, whole)


def test_command_lines_were_found():
    typed = [one for text in TEXTS.values() for one in typed_commands(text)]
    assert len(typed) >= 20
    assert sum(one.whole for one in typed) >= 3
    assert {parse(*one).name for one in typed} >= {"demo", "solve", "check", "simulate", "bench", "inspect"}


@pytest.mark.parametrize(
    "wrong",
    [
        "screwpose slove case -o out",
        "screwpose solve case -o out --fases 3",
        "screwpose solve case",
        "screwpose bench -o x --count all",
        "screwpose model look file",
    ],
)
def test_wrong_command_lines_are_seen(wrong):
    with pytest.raises(UsageError):
        parse(wrong.split())


def test_options_named_alone_exist():
    options = {option for command in _all_commands(COMMAND) for one in command.params for option in one.opts}
    named = {span.split()[0] for span in code_spans(EVERYTHING) if span.startswith("--")}
    assert len(named) >= 8
    assert named <= options | {"--help"}


def _all_commands(command):
    yield command
    for below in getattr(command, "commands", {}).values():
        yield from _all_commands(below)


def test_targets_of_make_exist():
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M))
    named = {words[1] for text in TEXTS.values() for words, _ in command_lines(text) if words[0] == "make"}
    assert {"demo", "test", "docs", "check", "lock"} <= named <= targets


def test_modules_and_what_is_in_them_exist():
    named = {span for span in code_spans(EVERYTHING) if re.fullmatch(r"screwpose(\.\w+)+(:[\w.]+)?", span)}
    named |= {re.search(r"screwpose(\.\w+)+", s)[0] for s in code_spans(EVERYTHING) if s.startswith("python -m ")}
    assert len(named) >= 40
    for name in named:
        resolve(name)


def resolve(name):
    """The object that ``package.module:Class.attribute`` or ``package.module.object`` names."""
    module, _, inside = name.partition(":")
    try:
        found = importlib.import_module(module)
    except ModuleNotFoundError:
        module, _, last = module.rpartition(".")
        found = getattr(importlib.import_module(module), last)
    for attribute in filter(None, inside.split(".")):
        found = getattr(found, attribute)
    return found


def test_numbers_are_those_of_the_code():
    rows = re.findall(r"^\| `(screwpose[\w.]*:[\w.]+)` \| (-?[\d.]+) \|", TEXTS["method.md"], re.M)
    assert len(rows) >= 20
    for name, number in rows:
        assert resolve(name) == float(number), name


def test_exit_codes_are_those_of_the_program():
    from screwpose.cli import terminal

    names = ("OK", "UNFORESEEN", "USAGE", "BAD_INPUT", "CANNOT_WRITE", "REFUSED", "WORSE", "INTERRUPTED")
    told = [int(code) for code in re.findall(r"^\| (\d+) \|", TEXTS["errors.md"], re.M)]
    assert told == [getattr(terminal, name) for name in names]


def test_the_tree_of_errors_is_that_of_the_code():
    from screwpose import errors

    told = re.findall(r"^[| `-]*(\w+Error)\b", blocks(TEXTS["errors.md"], "text")[1].text, re.M)
    classes = [name for name in vars(errors) if name.endswith("Error")]
    assert sorted(told) == sorted(classes)


def test_every_dependency_has_its_reason():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    groups = [group for name, group in project["dependency-groups"].items() if name != "dev"]
    extras = project["project"]["optional-dependencies"].values()
    required = [*project["project"]["dependencies"], *(one for group in [*groups, *extras] for one in group)]
    wanted = {re.match(r"[\w-]+", one)[0] for one in required}
    cells = re.findall(r"^\| ([a-z][\w, -]*) \| \S", TEXTS["dependencies.md"], re.M)
    told = {name.strip() for cell in cells for name in cell.split(",")} - {"package"}
    assert told == wanted


def test_every_room_of_the_house_has_its_floor():
    inside = [path for path in (ROOT / "src/screwpose").iterdir() if path.is_dir() or path.suffix == ".py"]
    rooms = {path.name for path in inside if not path.name.startswith("__")}
    rows = re.findall(r"^\| \d \| (.+?) \|", TEXTS["architecture.md"], re.M)
    told = [room.strip("`/") for row in rows for room in row.split(", ")]
    assert sorted(told) == sorted(rooms)


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_links_lead_somewhere(page):
    for link in links(TEXTS[page.name]):
        if link.startswith("https://"):
            continue
        place, _, anchor = link.partition("#")
        if page.parent.name == "docs" and place in GENERATED:
            assert GENERATED[place].is_file(), link
            continue
        target = page.parent / place if place else page
        assert target.is_file(), link
        if page.parent.name == "docs" or target.suffix != ".md":
            # What the site does not hold cannot be reached from it.
            assert page.parent.name != "docs" or target.resolve().is_relative_to(ROOT / "docs"), link
        if anchor:
            titles = re.findall(r"^#+ (.+)$", prose(target.read_text(encoding="utf-8")), re.M)
            assert anchor in {slug(title) for title in titles}, link


def slug(title):
    """The anchor that a heading gets."""
    return re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", title).strip().lower())


def test_links_were_found():
    assert sum(len(links(text)) for text in TEXTS.values()) >= 40
    assert sum("images/" in link for text in TEXTS.values() for link in links(text)) >= 4


def test_pictures_are_small():
    pictures = list((ROOT / "docs/images").iterdir())
    assert len(pictures) >= 3
    for picture in pictures:
        assert picture.read_bytes().startswith({".png": b"\x89PNG", ".jpg": b"\xff\xd8\xff"}[picture.suffix]), picture
        assert 5_000 < picture.stat().st_size < 300_000, picture
        assert f"images/{picture.name}" in EVERYTHING, f"{picture}: no page shows it"


def test_the_command_lines_page_is_what_the_program_says():
    assert TEXTS["cli.md"] == reference_page(), "run: python -m screwpose.cli.reference"
    for command in ("demo", "solve", "check", "simulate", "bench", "model inspect"):
        assert f"\n## screwpose {command}\n" in TEXTS["cli.md"]


def test_the_reference_writes_itself(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "screwpose.cli.reference", str(tmp_path / "cli.md")], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "cli.md").read_text(encoding="utf-8") == TEXTS["cli.md"]


def test_the_readme_says_what_a_stranger_needs():
    readme = TEXTS["README.md"]
    for words in ("make demo", "make test", "Not a medical device", "Apache-2.0", "screwpose model inspect"):
        assert words in readme
    assert readme.count("![") == 1
    licence = (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert "Apache License" in licence
    assert "END OF TERMS AND CONDITIONS" in licence


def test_the_files_page_names_every_key_of_every_format():
    from screwpose.files import schema_documents

    def keys(schema):
        for name, below in schema.items():
            if name == "properties":
                yield from below
            if isinstance(below, dict):
                yield from keys(below)

    text = TEXTS["files.md"]
    named = {key for schema in schema_documents().values() for key in keys(schema)}
    assert {"projection", "world_from_cad", "chosen_by", "confident_wrong"} <= named
    missing = [key for key in sorted(named) if not re.search(rf"\b{key}\b", text)]
    assert missing == []
