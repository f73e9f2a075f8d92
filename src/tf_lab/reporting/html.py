"""Pages that are one file each: pictures and scripts inside, and no request to anybody."""

from __future__ import annotations

import base64
import io
from html import escape
from itertools import groupby
from typing import TYPE_CHECKING

from tf_lab.reporting.formats import ARROWS, Cell, Table
from tf_lab.support.tables import NOTHING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# a browser refuses whatever is not in the file
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
STYLE = """
body{font:15px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color:#222}
h1{font-size:1.6rem}h2{font-size:1.2rem;margin-top:2rem;border-bottom:1px solid #ddd}
table{border-collapse:collapse;margin:.5rem 0;font-size:.85rem;display:block;overflow-x:auto}
th,td{padding:.2rem .6rem;text-align:right;white-space:nowrap}
th:first-child,td:first-child{text-align:left}
thead tr:last-child th{border-bottom:1px solid #222}.spans th{text-align:center}
tbody tr:first-child td{border-top:1px solid #bbb}
img{max-width:100%}pre{background:#f6f6f6;padding:.6rem;overflow-x:auto;font-size:.8rem}
canvas{width:100%;height:30rem;background:#fff;border:1px solid #ddd;touch-action:none}
figure{margin:.5rem 0}figcaption{font-size:.85rem;color:#555}summary{cursor:pointer}
"""


def page(title: str, *parts: str) -> str:
    """A whole page with a title, of parts in HTML."""
    return (
        "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'>"
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        "<meta name='viewport' content='width=device-width'>"
        f"<title>{escape(title)}</title><style>{STYLE}</style></head>\n"
        f"<body><h1>{escape(title)}</h1>\n" + "\n".join(filter(None, parts)) + "\n</body></html>\n"
    )


def section(heading: str, *parts: str) -> str:
    """Parts in HTML under a heading; nothing without any."""
    content = "\n".join(filter(None, parts))
    return f"<h2>{escape(heading)}</h2>\n{content}" if content else ""


def paragraph(text: str) -> str:
    """A text."""
    return f"<p>{escape(text)}</p>"


def folded(summary: str, text: str) -> str:
    """A long text that is opened by a click."""
    return f"<details><summary>{escape(summary)}</summary><pre>{escape(text)}</pre></details>"


def code(text: str) -> str:
    """A text to be copied."""
    return f"<pre>{escape(text)}</pre>"


def table_html(table: Table) -> str:
    """A table with its caption; nothing if it has no rows."""
    if not any(table.groups):
        return ""
    head = "".join(
        f"<th>{escape(f'{c.title} {ARROWS[c.better][0]}'.strip())}</th>" for c in table.columns
    )
    groups = "".join(
        "<tbody>" + "".join(f"<tr>{''.join(map(_cell, row))}</tr>" for row in group) + "</tbody>"
        for group in table.groups
        if group
    )
    caption = f"<p>{escape(table.caption)}</p>" if table.caption else ""
    return f"{caption}<table><thead>{_spans(table)}<tr>{head}</tr></thead>{groups}</table>"


def _spans(table: Table) -> str:
    """The row of headings over several columns; nothing without any."""
    spans = [(span, len([*columns])) for span, columns in groupby(c.span for c in table.columns)]
    if not any(span for span, _ in spans):
        return ""
    cells = "".join(f"<th colspan='{width}'>{escape(span)}</th>" for span, width in spans)
    return f"<tr class='spans'>{cells}</tr>"


def _cell(cell: Cell) -> str:
    if isinstance(cell, str):
        return f"<td>{escape(cell or NOTHING)}</td>"
    value, spread = cell.parts()
    value = f"<b>{value}</b>" if cell.best else value
    return f"<td>{f'{value} ± {spread}' if spread else value or NOTHING}</td>"


def picture(content: bytes, kind: str, caption: str) -> str:
    """An encoded picture ("jpeg", "png", "svg+xml") with its caption."""
    data = base64.b64encode(content).decode()
    text = escape(caption)
    return (
        f"<figure><img alt='{text}' src='data:image/{kind};base64,{data}'>"
        f"<figcaption>{text}</figcaption></figure>"
    )


def chart(figure: Figure, caption: str) -> str:
    """A chart as SVG."""
    import matplotlib

    content = io.BytesIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "tf_lab"}):
        figure.savefig(content, format="svg", facecolor="white", metadata={"Date": None})
    return picture(content.getvalue(), "svg+xml", caption)
