"""All finished runs as the paper's tables and charts, beside the paper's numbers."""

from __future__ import annotations

from pathlib import Path

from tf_lab.config.schema import ReportConfig
from tf_lab.errors import TFLabError
from tf_lab.reporting.formats import markdown
from tf_lab.reporting.orderings import summary
from tf_lab.reporting.report import describe, write_report
from tf_lab.reporting.results import keep_run
from tf_lab.reporting.studies import Study, open_study
from tf_lab.reporting.tables import settings_table, short_table
from tf_lab.support.files import check_folder
from tf_lab.support.layout import PICTURES, RUNS
from tf_lab.support.words import counted


def run(config: ReportConfig) -> None:
    """Read the runs; print the main table; write tables, orderings, charts and pictures."""
    folders = [config.runs] if isinstance(config.runs, str) else config.runs
    output = Path(config.output)
    check_folder(output)
    if not any(Path(folder).exists() for folder in folders) and (output / RUNS).is_dir():
        raise TFLabError(
            f"{', '.join(folders)}: there is no such folder; output= is where the report goes, the "
            f"runs in it are given by runs={output / RUNS}"
        )
    study, remarks = open_study(folders, config.study)
    if config.keep:
        kept = {keep_run(r, output / RUNS) for s in (study, *study.others) for r in s.runs.values()}
        if others := {*(output / RUNS).iterdir()} - kept:
            remarks.append(
                f"{output / RUNS}: keeps {counted(len(others), 'run')} more, of which this report "
                f"has nothing, such as {min(others).name}"
            )
    write_report(study, remarks, output)
    pictures = 0
    if config.pictures:
        from tf_lab.reporting.gallery import draw_pictures  # imports trimesh

        pictures = draw_pictures(study, output / PICTURES)
    figures, left_out = _draw_figures(config, study, output / "figures")
    if config.pages:
        from tf_lab.reporting.pages import write_pages  # imports trimesh

        pngs = [path for path in figures if path.suffix == ".png"]
        write_pages(study, describe(study), remarks, output, pngs)
    tables = [markdown(t) for t in (short_table(study), settings_table(study)) if any(t.groups)]
    print(describe(study), *remarks, *tables, summary(study), sep="\n\n")
    pages = "report.html, " * config.pages
    drawn = f"{pictures} pictures of test scenes, {len(figures)} files of figures"
    print(f"\n{output}: {pages}tables.md, orderings.md, charts, {drawn}", *left_out, sep="\n")


def _draw_figures(config: ReportConfig, study: Study, folder: Path) -> tuple[list[Path], list[str]]:
    """Draw what the runs have something for: the files, and lines on what they have nothing for."""
    if not config.figures:
        return [], []
    from tf_lab.commands.figures import material_of  # imports torch
    from tf_lab.reporting.figures.catalog import draw_figures

    return draw_figures(config.figures, material_of(study, config.benchmark), folder)
