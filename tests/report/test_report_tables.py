"""The paper's tables: against rows written by hand."""

import csv
import io

import pytest
from rich.console import Console

from screwpose.files.schema import ResultFile
from screwpose.report.tables import (
    Column,
    Table,
    chosen_combination,
    combination_table,
    pairing_table,
    pairs_text,
    same_pairs,
)

RIGHT = [{"AP": "1", "LAT": "b"}, {"AP": "2", "LAT": "a"}]
SWAPPED = [{"AP": "1", "LAT": "a"}, {"AP": "2", "LAT": "b"}]


def scores(dice, ap, lat):
    views = {"AP": {"dice": dice, "loss": ap}, "LAT": {"dice": dice, "loss": lat}}
    return {"dice": dice, "loss": (ap + lat) / 2, "views": views}


def answer(case="set1", probability=0.99, with_post=True, chosen=RIGHT, named=(1, 1), **changes):
    content = {
        "format": "screwpose-result/1",
        "case": case,
        "software": {"name": "screwpose", "version": "0.1.0"},
        "status": "confident",
        "pairing": {
            "status": "confident",
            "probability": probability,
            "pairs": chosen,
            "unpaired": {},
            "chosen_by": {"pre": named[0], "post": named[1]},
        },
        "combinations": [
            {
                "id": 1,
                "pairs": RIGHT,
                "probability": probability,
                "pre": scores(0.86, -0.25, -0.125),
                "post": scores(0.91, -0.5, -0.25) if with_post else None,
            },
            {
                "id": 2,
                "pairs": SWAPPED,
                "probability": None if probability is None else 1 - probability,
                "pre": scores(0.5, -0.0625, 0.0),
                "post": scores(0.625, -0.25, -0.125) if with_post else None,
            },
        ],
        "screws": [],
        "warnings": [],
        "timing_s": {},
    }
    return ResultFile.model_validate(content | changes)


def test_table_2_has_a_row_for_every_combination_of_every_set():
    table = combination_table([answer(), answer("set2", chosen=SWAPPED)], {"set1": RIGHT})
    assert [column.key for column in table.columns] == [
        "set", "combination", "pairs", "truth", "chosen", "probability",
        "pre_dice", "pre_loss", "pre_loss_AP", "pre_loss_LAT",
        "post_dice", "post_loss", "post_loss_AP", "post_loss_LAT",
    ]  # fmt: skip
    assert table.groups == (("", 6), ("Pre", 4), ("Post", 4))
    assert table.rows[0] == (
        "set1", 1, "AP 1 / LAT b, AP 2 / LAT a", "correct", "chosen", 0.99,
        0.86, -0.1875, -0.25, -0.125, 0.91, -0.375, -0.5, -0.25,
    )  # fmt: skip
    assert [row[3:5] for row in table.rows] == [
        ("correct", "chosen"),
        ("wrong", "rejected"),
        (None, "rejected"),
        (None, "chosen"),
    ]
    assert table.emphasis == {0, 3}


def test_columns_without_content_are_left_out_and_missing_scores_are_dashes():
    table = combination_table([answer(probability=None, with_post=False)])
    keys = [column.key for column in table.columns]
    assert "probability" not in keys
    assert "truth" not in keys
    assert table.cells()[0][keys.index("post_dice")] == "-"
    assert table.rows[0][keys.index("post_loss_AP")] is None
    assert list(csv.reader(io.StringIO(table.to_csv())))[1][-1] == ""


def test_a_view_that_one_set_lacks_is_empty_there():
    other = answer("set2").model_dump()
    for one in other["combinations"]:
        for stage in ("pre", "post"):
            one[stage]["views"] = {"LAT": one[stage]["views"]["LAT"]}
    table = combination_table([answer(), ResultFile.model_validate(other)])
    column = [column.key for column in table.columns].index("pre_loss_AP")
    assert [row[column] for row in table.rows] == [-0.25, -0.0625, None, None]


def test_a_refused_answer_has_nothing_chosen():
    refused = answer(status="refused", warnings=["no"], pairing={"status": "refused", "pairs": [], "unpaired": {}})
    assert chosen_combination(refused) is None
    table = combination_table([refused])
    assert table.emphasis == frozenset()
    assert {row[3] for row in table.rows} == {""}


def test_the_order_of_screws_and_views_does_not_matter_and_single_labels_are_no_pairs():
    assert same_pairs(RIGHT, [{"LAT": "a", "AP": "2"}, {"LAT": "b", "AP": "1"}, {"AP": "3"}])
    assert not same_pairs(RIGHT, SWAPPED)
    assert not same_pairs(RIGHT, RIGHT[:1])
    assert pairs_text(RIGHT) == "AP 1 / LAT b, AP 2 / LAT a"


def test_csv_keeps_numbers_in_full():
    rows = list(csv.DictReader(io.StringIO(combination_table([answer(probability=1 / 3)]).to_csv())))
    assert float(rows[0]["probability"]) == 1 / 3
    assert rows[1]["pairs"] == "AP 1 / LAT a, AP 2 / LAT b"


@pytest.mark.parametrize("text", ["=1+1", "@x", "+1", "-1", "\tx"])
def test_csv_texts_cannot_be_formulas(text):
    table = Table("", (Column("a", "A"),), ((text,),))
    assert list(csv.reader(io.StringIO(table.to_csv())))[1] == [f"'{text}"]
    assert "\n-0.5\n" in Table("", (Column("a", "A"),), ((-0.5,),)).to_csv()


def test_markdown_is_as_written_by_hand():
    columns = (Column("a", "Set", is_number=False), Column("b", "Dice", "Pre", digits=2))
    table = Table("T", columns, (("x|y<b>_", 0.5), ("z\nw", None)), frozenset({1}))
    assert table.to_markdown() == (
        "| Set | Pre Dice |\n| :--- | ---: |\n| x\\|y&lt;b>\\_ | 0.50 |\n| **z w** | **-** |\n"
    )


def test_table_1_says_what_dice_chooses_and_counts_the_right_ones():
    sets = [answer("set1", named=(1, 1)), answer("set2", named=(2, 1)), answer("set3", named=(1, None))]
    table = pairing_table(sets, {"set1": RIGHT, "set2": RIGHT, "set3": RIGHT})
    right, swapped = pairs_text(RIGHT), pairs_text(SWAPPED)
    assert table.rows == (
        ("set1", 2, right, True, right, True),
        ("set2", 2, swapped, False, right, True),
        ("set3", 2, right, True, None, None),
        ("all", None, "", "2 of 3", "", "2 of 3"),
    )
    assert table.cells()[1][3] == "no"
    assert len(pairing_table(sets).rows) == 3


def test_the_terminal_shows_the_same_cells_and_no_markup():
    odd = answer("[red]set")
    console = Console(width=220, file=io.StringIO(), color_system=None)
    console.print(combination_table([odd]).to_rich())
    text = console.file.getvalue()
    assert "[red]set" in text
    assert "-0.188" in text


def test_without_drops_columns_and_keeps_the_rest():
    table = combination_table([answer()])
    less = table.without("set", "pairs")
    assert [column.key for column in less.columns][:2] == ["combination", "chosen"]
    assert less.rows[0][0] == 1
    assert less.emphasis == table.emphasis
