"""Tables as plain text, for terminals, logs and files alike."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

from rich.console import Console
from rich.table import Table
from rich.text import Text

NOTHING = "-"  # for a number that there is not
Side = Literal["left", "right"]
SIDES: dict[str, Side] = {side[0]: side for side in get_args(Side)}


def aligned(
    rows: Sequence[Sequence[str]],
    sides: str = "lr",
    head: Sequence[str] = (),
    rule: bool = False,
    width: int = 0,
) -> str:
    """Rows of cells as lines whose columns are aligned: never wrapped, coloured or cut.

    Args:
        rows: cells of one line each; as many in every row.
        sides: "l" or "r" a column, as in LaTeX; the last is that of all further columns.
        head: headings of the columns.
        rule: a line of dashes under the headings.
        width: least width of a column.
    """
    lines = [head, *rows] if head else rows
    table = Table.grid(padding=(0, 2))
    for i in range(len(lines[0]) if lines else 0):
        side = SIDES[sides[min(i, len(sides) - 1)]]
        table.add_column(justify=side, no_wrap=True, min_width=width)
    for line in lines:
        table.add_row(*map(Text, line))
    console = Console(width=100_000, color_system=None, force_terminal=False)
    with console.capture() as text:
        console.print(table)
    printed = [line.rstrip() for line in text.get().splitlines()]
    if rule and printed:
        printed.insert(1, "-" * max(map(len, printed)))
    return "\n".join(printed)
