"""The one table of all pages."""

from training.pages.page import part
from training.pages.table import PageTable


def shown(table: PageTable) -> str:
    return table.__html__()


def test_numbers_stand_right_and_words_left() -> None:
    # GIVEN a column of numbers with a unit, a missing one and a large one, and one of words
    table = PageTable(part, "signal", "time", "verdict")
    table.row("flow", "3.5 s", "better")
    table.row("7 bar", "–", "")
    table.row("speed", 12345, "2 of 3, worse")
    # WHEN it is put into a page
    # THEN only the column of numbers stands right, its head, too; the first column names the row
    assert table.columns == ["", "n", ""]
    assert '<th class="n">time</th>' in shown(table)
    assert '<td class="n">12,345</td>' in shown(table)
    assert '<td>7 bar</td><td class="n">–</td><td></td>' in shown(table)


def test_cells_are_escaped_and_a_chosen_row_is_set_off() -> None:
    table = PageTable(part, "a <b>", rows=[("x & y",)])
    table.row("<i>", chosen=True)
    assert "<th>a &lt;b&gt;</th>" in shown(table)
    assert "<tr><td>x &amp; y</td></tr>" in shown(table)
    assert '<tr class="chosen"><td>&lt;i&gt;</td></tr>' in shown(table)


def test_long_texts_have_room_and_every_table_scrolls() -> None:
    table = PageTable(part, rows=[("short", "a text that is longer than a cell of a phone")])
    assert table.columns == ["", "long"]
    assert shown(table).startswith('<div class="scroll">')
