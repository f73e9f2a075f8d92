"""Tables of README and docs that repeat what lies in results/; as a script it renews them."""

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
COLUMNS = ("acc", "compl", "chamfer", "prec", "recall", "fscore")
SMALLER_IS_BETTER = ("acc", "compl", "chamfer")
PAPER = [
    "Ours: w/o TRSF, avg",
    "Ours: w/o TRSF, pred",
    "Ours: w/o spatial ref.",
    "Ours: 4 images, RND",
    "Ours: 4 images",
    "Ours: 8 images, RND",
    "Ours: 8 images",
    "Ours: 16 images, RND",
    "Ours: w/o C2F filter",
    "Ours: w/o projected depth",
    "Ours: w/o view ray",
    "Ours",
]
BEYOND = ["Ours: + matching", *(f"Ours: {k} images, diverse (ours)" for k in (4, 8, 16))]
SELECTION = {
    "attention": ["Ours: 4 images", "Ours: 8 images", "Ours"],
    "random": [f"Ours: {k} images, RND" for k in (4, 8, 16)],
    "diverse (ours)": BEYOND[1:],
}
Scores = dict[str, dict[str, str]]  # row -> column -> value


def scores(study: str, *tables: str) -> Scores:
    """Rows of a study's CSV tables together."""
    found: Scores = {}
    for table in tables:
        with (ROOT / "results" / study / f"{table}.csv").open() as file:
            for row in csv.DictReader(file):
                found.setdefault(row["row"], {}).update(row)
    return found


def cells(of: Scores, rows: list[str], column: str) -> list[str]:
    """A column's cells, mean ± deviation, the best in bold."""
    digits = 2 if column in SMALLER_IS_BETTER else 3
    means = [round(float(of[row][column]), digits) for row in rows]
    best = (min if column in SMALLER_IS_BETTER else max)(means)
    found = []
    for row, mean in zip(rows, means, strict=True):
        cell = f"**{mean:.{digits}f}**" if mean == best else f"{mean:.{digits}f}"
        deviation = of[row][f"{column}_deviation"]
        found.append(cell + (f" ± {float(deviation):.{digits}f}" if deviation else ""))
    return found


def table(*columns: list[str]) -> list[str]:
    """Lines of Markdown from columns."""
    return [f"| {' | '.join(row)} |" for row in zip(*columns, strict=True)]


def to_ours(of: Scores, row: str) -> str:
    found = of[row]
    if not found.get("difference"):
        return ""
    difference, low, high = (float(found[name]) for name in ("difference", "low", "high"))
    return f"{difference:+.3f} ({low:+.3f} to {high:+.3f})"


def in_paper(of: Scores, row: str) -> str:
    value = of[row]["paper_fscore"]
    return f"{float(value):.3f}" if value else "-"


def ablation(*columns: str) -> list[str]:
    rows, of = PAPER + BEYOND, scores("flats", "main", "inputs", "comparison")
    return table(
        rows,
        [of[row]["seeds"] for row in rows],
        *(cells(of, rows, column) for column in columns),
        [to_ours(of, row) for row in rows],
        [in_paper(of, row) for row in rows],
    )


def rooms() -> list[str]:
    of = scores("reference", "main", "inputs")
    columns = [cells(of, PAPER, column) for column in COLUMNS]
    return table(PAPER, *columns, [in_paper(of, row) for row in PAPER])


def selection(study: str, *rules: str) -> list[str]:
    of = scores(study, "main")
    by_views = [cells(of, [SELECTION[rule][k] for rule in rules], "fscore") for k in range(3)]
    return table(list(rules), *by_views)


def kept_views(*rules: str) -> list[str]:
    of = scores("flats", "views")

    def column(name: str, k: int, text: Callable[[float], str]) -> list[str]:
        return [text(float(of[SELECTION[rule][k]][name])) for rule in rules]

    seeing = [column("visible", k, lambda share: f"{100 * share:.0f} %") for k in range(3)]
    variety = [column("variety", k, lambda count: f"{count:.0f}") for k in range(3)]
    return table(list(rules), *seeing, *variety)


def kitchen() -> list[str]:
    """The rows beside selection's: views by attention (averaging: at random), K = 16."""
    of = scores("redkitchen", "main", "inputs")
    rows = {
        "mean fusion (no weights to select by: random)": "Ours: w/o TRSF, avg",
        "predicted weights": "Ours: w/o TRSF, pred",
        "without spatial refinement": "Ours: w/o spatial ref.",
        "without the filter": "Ours: w/o C2F filter",
        "without projected depth": "Ours: w/o projected depth",
        "without view ray": "Ours: w/o view ray",
        "with matching (ours)": "Ours: + matching",
    }
    empty = [""] * len(rows)
    found = [cell.replace("*", "") for cell in cells(of, list(rows.values()), "fscore")]
    others = [line.replace("|  |  |", "| | |") for line in table(list(rows), empty, empty, found)]
    return selection("redkitchen", "attention", "random", "diverse (ours)") + others


@dataclass(frozen=True)
class Repeated:
    """A table of a document, found by its section's heading and how its head begins."""

    document: str
    section: str
    head: str
    lines: Callable[[], list[str]]

    def place(self, text: list[str]) -> slice:
        """Where its rows are among the lines of the document."""
        section = text.index(self.section)
        head = next(i for i in range(section, len(text)) if text[i].startswith(self.head))
        end = next(i for i in range(head, len(text)) if not text[i].startswith("|"))
        return slice(head + 2, end)


RANDOM_FIRST = ("random", "attention", "diverse (ours)")
STUDY = "docs/study.md"
WALLS = "### Selection where walls hide views"
TABLES = {
    "readme": Repeated(
        "README.md", "## The ablation study", "| Method | Trainings |", lambda: ablation("fscore")
    ),
    "ablation": Repeated(
        STUDY, "## The ablation study", "| Method | Seeds |", lambda: ablation(*COLUMNS)
    ),
    "selection": Repeated(STUDY, WALLS, "| F-score |", lambda: selection("flats", *RANDOM_FIRST)),
    "kept views": Repeated(STUDY, WALLS, "| | kept views", lambda: kept_views(*RANDOM_FIRST)),
    "kitchen": Repeated(STUDY, "### The same networks on a real scene", "| F-score |", kitchen),
    "rooms": Repeated(STUDY, "## Single rooms, three seeds", "| Method |", rooms),
}


@pytest.mark.parametrize("name", list(TABLES))
def test_tables_repeat_the_results(name: str) -> None:
    found = TABLES[name]
    text = (ROOT / found.document).read_text().splitlines()
    assert text[found.place(text)] == found.lines()


def refresh() -> None:
    """Write the tables into their documents."""
    for found in TABLES.values():
        path = ROOT / found.document
        text = path.read_text().splitlines()
        text[found.place(text)] = found.lines()
        path.write_text("\n".join(text) + "\n")


if __name__ == "__main__":
    refresh()
