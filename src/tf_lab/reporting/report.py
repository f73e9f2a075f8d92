"""The report of a study: its tables, orderings and charts as text and files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tf_lab.reporting.charts import rows_chart, save_chart, views_chart
from tf_lab.reporting.formats import Table, comma_separated, latex, markdown
from tf_lab.reporting.orderings import summary
from tf_lab.reporting.paper import ABLATIONS
from tf_lab.reporting.studies import Study
from tf_lab.reporting.tables import (
    comparison_table,
    inputs_table,
    main_table,
    orderings_table,
    runs_table,
    scene_table,
    seed_table,
    settings_table,
    views_table,
)
from tf_lab.support.files import write_text
from tf_lab.support.words import counted

CHARTS = {"chart_views": views_chart, "chart_rows": rows_chart}


def write_report(study: Study, remarks: Sequence[str], output: Path) -> None:
    """Write tables (Markdown, LaTeX, CSV), orderings and charts to a folder."""
    pages = {
        "main": main_table(study),
        "inputs": inputs_table(study),
        "comparison": comparison_table(study),
        "settings": settings_table(study),
        "seeds": seed_table(study),
        "scenes": scene_table(study),
        "views": views_table(study),
    }
    orderings = orderings_table(study)
    for name, table in {**pages, "orderings": orderings}.items():
        for path, form in (
            (output / f"table_{name}.tex", latex),
            (output / f"{name}.csv", comma_separated),
        ):
            if any(table.groups):
                write_text(path, form(table))
            else:
                path.unlink(missing_ok=True)  # of another study's report
    write_text(output / "runs.csv", comma_separated(runs_table(study)))
    write_text(output / "tables.md", tables_page(study, remarks, list(pages.values())))
    write_text(output / "orderings.md", orderings_page(study, orderings))
    for name, draw in CHARTS.items():
        save_chart(draw(study), output / name)


def tables_page(study: Study, remarks: Sequence[str], tables: Sequence[Table]) -> str:
    """What the study is, the remarks on it, and its tables, as Markdown."""
    parts = ["# Results", describe(study), *[f"- {remark}" for remark in remarks]]
    parts += [f"## {t.name.capitalize()}\n\n{_captioned(t)}" for t in tables if any(t.groups)]
    return "\n\n".join(parts) + "\n"


def orderings_page(study: Study, orderings: Table) -> str:
    """The paper's orderings as Markdown: how many hold, and each."""
    counts = "\n".join(f"- {line}" for line in summary(study).splitlines())
    parts = ["# Orderings", counts]
    parts += [_captioned(orderings)] if any(orderings.groups) else []
    return "\n\n".join(parts) + "\n"


def _captioned(table: Table) -> str:
    return f"{table.caption}\n\n{markdown(table)}"


def describe(study: Study) -> str:
    """What was run, in a few words."""
    s = study.settings
    elsewhere = s.get("test.data.name")  # test_on=
    data = f"data={s['data.name']}" + (f" test_on={elsewhere}" if elsewhere else "")
    given = s.get("test.content.groundtruth") is not None
    by = " scored by the ground truth given (groundtruth=)" if given else ""
    seeds = "seed" if len(study.seeds()) == 1 else "seeds"
    text = (
        f"Study {study.key}: {counted(len(study.runs), 'run')} of "
        f"{counted(len(study.rows), 'row')}, {seeds} "
        f"{', '.join(map(str, study.seeds()))}; {data}, model={s['model.name']}, "
        f"{s['optimizer.steps']} steps; {counted(len(study.scenes), 'test scene')}{by}, "
        f"meshed at {100 * s['test.resolution']:g} cm."
    )
    missing, rows = study.missing, len(ABLATIONS) + 1
    if missing and study.alone:
        text += f" {len(missing)} of the paper's {rows} rows have no run yet."
    elif missing:
        text += f" Missing: {'; '.join(missing)}."
    return text
