"""The paper's two tables, from one structure, as CSV, Markdown, and rows for the terminal and the web page.

Table 1 says which combination each set's Dice score chooses before and after registration, and whether it is right;
table 2 gives Dice, mean loss and the loss in each view for every combination, before and after.

References
----------
arXiv 2511.05702, tables 1 and 2.
"""

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from screwpose.files.schema import CombinationFile, ResultFile
from screwpose.report.palette import screw_name

if TYPE_CHECKING:
    import rich.table

Value: TypeAlias = str | int | float | bool | None
Pairs: TypeAlias = Iterable[Mapping[str, str]]
_ABSENT = "-"


@dataclass(frozen=True)
class Column:
    """A column: `key` names it for machines, `title` under `group` for people; `digits` behind the point of a float."""

    key: str
    title: str
    group: str = ""
    digits: int = 3
    is_number: bool = True


@dataclass(frozen=True)
class Table:
    """Rows of values, one a column; `emphasis` holds the indices of rows that stand out (the chosen combination)."""

    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Value, ...], ...]
    emphasis: frozenset[int] = frozenset()

    @property
    def groups(self) -> tuple[tuple[str, int], ...]:
        """The upper header: (title, number of columns below it), in order; an empty title over ungrouped columns."""
        spans: list[tuple[str, int]] = []
        for column in self.columns:
            if spans and spans[-1][0] == column.group:
                spans[-1] = (column.group, spans[-1][1] + 1)
            else:
                spans.append((column.group, 1))
        return tuple(spans)

    def without(self, *keys: str) -> "Table":
        """The table less some columns."""
        kept = [index for index, column in enumerate(self.columns) if column.key not in keys]
        rows = tuple(tuple(row[index] for index in kept) for row in self.rows)
        return Table(self.title, tuple(self.columns[index] for index in kept), rows, self.emphasis)

    def cells(self) -> tuple[tuple[str, ...], ...]:
        """Every value as people read it."""
        return tuple(
            tuple(_text(value, column) for value, column in zip(row, self.columns, strict=True)) for row in self.rows
        )

    def to_csv(self) -> str:
        """For machines: keys as header, numbers in full, an empty field where there is none."""
        buffer = io.StringIO()
        writer = csv.writer(buffer, lineterminator="\n")
        writer.writerow(column.key for column in self.columns)
        writer.writerows([_csv_field(value) for value in row] for row in self.rows)
        return buffer.getvalue()

    def to_markdown(self) -> str:
        """A pipe table; rows that stand out are bold."""
        titles = [f"{column.group} {column.title}" if column.group else column.title for column in self.columns]
        lines = [
            f"| {' | '.join(_escaped(title) for title in titles)} |",
            f"| {' | '.join('---:' if column.is_number else ':---' for column in self.columns)} |",
        ]
        for index, row in enumerate(self.cells()):
            texts = [_escaped(cell) for cell in row]
            if index in self.emphasis:
                texts = [f"**{text}**" if text else text for text in texts]
            lines.append(f"| {' | '.join(texts)} |")
        return "\n".join(lines) + "\n"

    def to_rich(self) -> "rich.table.Table":
        """For the terminal."""
        from rich.table import Table as RichTable
        from rich.text import Text

        table = RichTable(title=self.title or None, title_justify="left")
        for column in self.columns:
            header = f"{column.group}\n{column.title}" if column.group else column.title
            table.add_column(Text(header), justify="right" if column.is_number else "left")
        for index, row in enumerate(self.cells()):
            table.add_row(*(Text(cell) for cell in row), style="bold" if index in self.emphasis else None)
        return table


def same_pairs(one: Pairs, other: Pairs) -> bool:
    """Whether two pairings join the same labels; screws that only one view shows are no pair and do not count."""
    return _joined(one) == _joined(other)


def chosen_combination(answer: ResultFile) -> CombinationFile | None:
    """The scored combination that the answer's pairing is; None where it was refused, or is none of them."""
    if answer.status == "refused" or answer.pairing.status == "refused":
        return None
    matches = (one for one in answer.combinations if same_pairs(one.pairs, answer.pairing.pairs))
    return next(matches, None)


def pairs_text(pairs: Pairs) -> str:
    """A combination in words: ``AP 1 / LAT b, AP 2 / LAT a``."""
    return ", ".join(screw_name(labels) for labels in pairs)


def combination_table(answers: Sequence[ResultFile], true_pairs: Mapping[str, Pairs] | None = None) -> Table:
    """Table 2 of the paper: every combination of every set, its scores before and after registration.

    Parameters
    ----------
    answers : one a set (case), in the order in which they are listed.
    true_pairs : the truth's labels by case id; a column says "correct" or "wrong" where any case has them.
    """
    true_pairs = true_pairs or {}
    views = list(dict.fromkeys(view for answer in answers for one in answer.combinations for view in one.pre.views))
    has_probability = any(one.probability is not None for answer in answers for one in answer.combinations)
    columns = [
        Column("set", "Set", is_number=False),
        Column("combination", "No."),
        Column("pairs", "Combination", is_number=False),
    ]
    if true_pairs:
        columns.append(Column("truth", "Truth", is_number=False))
    columns.append(Column("chosen", "Answer", is_number=False))
    if has_probability:
        columns.append(Column("probability", "Probability"))
    for stage, group in (("pre", "Pre"), ("post", "Post")):
        columns += [Column(f"{stage}_dice", "Dice", group), Column(f"{stage}_loss", "mean loss", group)]
        columns += [Column(f"{stage}_loss_{view}", f"{view} loss", group) for view in views]
    rows: list[tuple[Value, ...]] = []
    emphasis = set()
    for answer in answers:
        chosen = chosen_combination(answer)
        for one in answer.combinations:
            if one is chosen:
                emphasis.add(len(rows))
            row: list[Value] = [answer.case, one.id, pairs_text(one.pairs)]
            if true_pairs:
                row.append(_verdict(one, true_pairs.get(answer.case)))
            row.append("" if chosen is None else "chosen" if one is chosen else "rejected")
            if has_probability:
                row.append(one.probability)
            rows.append((*row, *_scores(one, views)))
    title = "Scores of every combination before (pre) and after (post) registration"
    return Table(title, tuple(columns), tuple(rows), frozenset(emphasis))


def pairing_table(answers: Sequence[ResultFile], true_pairs: Mapping[str, Pairs] | None = None) -> Table:
    """Table 1 of the paper: the combination with the higher Dice in each set, before and after registration.

    Parameters as in `combination_table`. The last row counts the sets that were paired right, where the truth is known.
    """
    true_pairs = true_pairs or {}
    columns = [Column("set", "Set", is_number=False), Column("combinations", "Combinations")]
    for stage, group in (("pre", "Pre"), ("post", "Post")):
        columns.append(Column(f"{stage}_chosen", "Chosen", group, is_number=False))
        if true_pairs:
            columns.append(Column(f"{stage}_right", "Right", group, is_number=False))
    rows: list[tuple[Value, ...]] = []
    right: dict[str, list[bool]] = {"pre": [], "post": []}
    for answer in answers:
        row: list[Value] = [answer.case, len(answer.combinations)]
        for stage, tally in right.items():
            one = _named_by_dice(answer, stage)
            row.append(None if one is None else pairs_text(one.pairs))
            if true_pairs:
                truth = true_pairs.get(answer.case)
                verdict = None if truth is None or one is None else same_pairs(one.pairs, truth)
                if truth is not None:
                    tally.append(bool(verdict))
                row.append(verdict)
        rows.append(tuple(row))
    if true_pairs:
        counts = {stage: f"{sum(tally)} of {len(tally)}" for stage, tally in right.items()}
        rows.append(("all", None, "", counts["pre"], "", counts["post"]))
    title = "The combination with the higher Dice score, before (pre) and after (post) registration"
    return Table(title, tuple(columns), tuple(rows), frozenset({len(rows) - 1} if true_pairs else ()))


def _joined(pairs: Pairs) -> set[frozenset[tuple[str, str]]]:
    return {frozenset(labels.items()) for labels in pairs if len(labels) > 1}


def _named_by_dice(answer: ResultFile, stage: str) -> CombinationFile | None:
    named = answer.pairing.chosen_by
    number = None if named is None else named.pre if stage == "pre" else named.post
    return next((one for one in answer.combinations if one.id == number), None)


def _verdict(one: CombinationFile, truth: Pairs | None) -> Value:
    if truth is None:
        return None
    return "correct" if same_pairs(one.pairs, truth) else "wrong"


def _scores(one: CombinationFile, views: Sequence[str]) -> list[Value]:
    values: list[Value] = []
    for scores in (one.pre, one.post):
        if scores is None:
            values += [None] * (2 + len(views))
            continue
        values += [scores.dice, scores.loss]
        values += [scores.views[view].loss if view in scores.views else None for view in views]
    return values


def _text(value: Value, column: Column) -> str:
    if value is None:
        return _ABSENT
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.{column.digits}f}" if isinstance(value, float) else str(value)


def _csv_field(value: Value) -> Value:
    """A text that a spreadsheet would run as a formula is quoted: labels come from other people's files."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"'{value}" if isinstance(value, str) and value[:1] in ("=", "+", "-", "@", "\t", "\r") else value


def _escaped(text: str) -> str:
    """Text that Markdown shows as it is."""
    text = text.replace("&", "&amp;").replace("<", "&lt;").replace("\\", "\\\\")
    for mark in "|*_`[":
        text = text.replace(mark, f"\\{mark}")
    return " ".join(text.split())
