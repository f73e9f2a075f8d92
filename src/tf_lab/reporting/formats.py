"""A table as Markdown, LaTeX (booktabs) and CSV."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from itertools import groupby

from tf_lab.support.tables import NOTHING

ARROWS = {"up": ("↑", r"$\uparrow$"), "down": ("↓", r"$\downarrow$"), "": ("", "")}
LATEX_NEEDS = "% needs booktabs and graphicx"
_LATEX = {
    **{character: f"\\{character}" for character in "&%#_{}$"},
    **{"<": "$<$", ">": "$>$", "±": r"$\pm$", "\\": r"\textbackslash{}"},
}


@dataclass(frozen=True)
class Number:
    """A number with its deviation, if any; None is shown as missing."""

    value: float | None
    format: str = ".3f"
    deviation: float | None = None
    best: bool = False

    def parts(self) -> tuple[str, str]:
        """The number and its deviation as text; "" for what there is not."""
        if self.value is None:
            return "", ""
        unsigned = self.format.removeprefix("+")
        spread = "" if self.deviation is None else format(self.deviation, unsigned)
        return format(self.value, self.format), spread


Cell = str | Number
Row = tuple[Cell, ...]


@dataclass(frozen=True)
class Column:
    """A column: its name in CSV files, its heading, which way is better, what it belongs to."""

    key: str
    title: str
    better: str = ""
    span: str = ""


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes:
        name: of its files and its LaTeX label.
        caption: a sentence or two.
        columns: the first holds names, the others numbers or short words.
        groups: the rows between two rules a group.
    """

    name: str
    caption: str
    columns: tuple[Column, ...]
    groups: tuple[tuple[Row, ...], ...]


def markdown(table: Table) -> str:
    """The table as Markdown whose columns are aligned, so that it reads well as text."""
    first = next((column.span for column in table.columns if column.span), "")
    head = []
    for column in table.columns:
        title = f"{column.title} {ARROWS[column.better][0]}".strip()
        head.append(title if column.span in ("", first) else f"{title} ({column.span.lower()})")
    rows = [[_markdown_cell(cell) for cell in row] for group in table.groups for row in group]
    widths = [max(2, *map(len, column)) for column in zip(head, *rows, strict=True)]
    rule = [":" + "-" * (widths[0] - 1), *("-" * (width - 1) + ":" for width in widths[1:])]

    def line(cells: list[str]) -> str:
        rest = (cell.rjust(width) for cell, width in zip(cells[1:], widths[1:], strict=True))
        return "| " + " | ".join([cells[0].ljust(widths[0]), *rest]) + " |"

    return "\n".join([line(head), line(rule), *map(line, rows)])


def _markdown_cell(cell: Cell) -> str:
    if isinstance(cell, str):
        return cell.replace("|", r"\|") or NOTHING
    value, spread = cell.parts()
    value = f"**{value}**" if cell.best else value
    return (f"{value} ± {spread}" if spread else value) or NOTHING


def latex(table: Table) -> str:
    """The table as a LaTeX float, shrunk to the width of the text where it is wider."""
    columns = table.columns
    heads = [f"{_escape(c.title)} {ARROWS[c.better][1]}".strip() for c in columns]
    groups = [
        "\n".join("    " + " & ".join(map(_latex_cell, row)) + r" \\" for row in group)
        for group in table.groups
        if group
    ]
    return "\n".join(
        [
            LATEX_NEEDS,
            r"\begin{table}",
            r"  \centering",
            rf"  \caption{{{_escape(table.caption)}}}",
            rf"  \label{{tab:{table.name}}}",
            r"  \resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%",
            rf"  \begin{{tabular}}{{l{'c' * (len(columns) - 1)}}}",
            r"    \toprule",
            *_spans(columns),
            "    " + " & ".join(heads) + r" \\",
            r"    \midrule",
            "\n    \\midrule\n".join(groups),
            r"    \bottomrule",
            r"  \end{tabular}}",
            r"\end{table}",
            "",
        ]
    )


def _spans(columns: tuple[Column, ...]) -> list[str]:
    """The line of headings over several columns, and the rules under them; none without any."""
    if not any(column.span for column in columns):
        return []
    cells, rules, start = [], [], 1
    for span, members in groupby(columns, key=lambda column: column.span):
        width = len(list(members))
        if span:
            cells.append(rf"\multicolumn{{{width}}}{{c}}{{{_escape(span)}}}")
            rules.append(rf"\cmidrule(lr){{{start}-{start + width - 1}}}")
        else:
            cells += [""] * width
        start += width
    return ["    " + " & ".join(cells) + r" \\", "    " + " ".join(rules)]


def _latex_cell(cell: Cell) -> str:
    if isinstance(cell, str):
        return _escape(cell) or "--"
    value, spread = cell.parts()
    if not value:
        return "--"
    value = rf"\mathbf{{{value}}}" if cell.best else value
    return f"${value}_{{\\pm {spread}}}$" if spread else f"${value}$"


def _escape(text: str) -> str:
    return "".join(_LATEX.get(character, character) for character in text)


def comma_separated(table: Table) -> str:
    """The table as CSV; a deviation is a column of its own after its number's."""
    rows = [row for group in table.groups for row in group]
    cells = list(zip(*rows, strict=True)) or [()] * len(table.columns)
    spread = [
        any(isinstance(cell, Number) and cell.deviation is not None for cell in column)
        for column in cells
    ]
    head = []
    for column, deviates in zip(table.columns, spread, strict=True):
        head += [column.key, f"{column.key}_deviation"] if deviates else [column.key]
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(head)
    for row in rows:
        line = []
        for cell, deviates in zip(row, spread, strict=True):
            values = (cell.value, cell.deviation) if isinstance(cell, Number) else (cell, None)
            line += [_digits(value) for value in (values if deviates else values[:1])]
        writer.writerow(line)
    return file.getvalue()


def _digits(value: str | float | None) -> str:
    if isinstance(value, float | int):
        return f"{value:.6g}"
    return value or ""
