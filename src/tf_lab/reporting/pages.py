"""A study and each of its runs as pages to open offline or to mail."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import yaml

from tf_lab.config.stored import portable_config
from tf_lab.errors import TFLabError
from tf_lab.experiments.provenance import without_places
from tf_lab.meshes.files import read_mesh
from tf_lab.reporting.charts import rows_chart, views_chart
from tf_lab.reporting.gallery import preview, scenes_of
from tf_lab.reporting.html import (
    chart,
    code,
    folded,
    page,
    paragraph,
    picture,
    section,
    table_html,
)
from tf_lab.reporting.mesh_view import mesh_view
from tf_lab.reporting.orderings import summary
from tf_lab.reporting.results import Run
from tf_lab.reporting.studies import Study
from tf_lab.reporting.tables import (
    comparison_table,
    inputs_table,
    main_table,
    orderings_table,
    run_table,
    scene_table,
    seed_table,
    settings_table,
)
from tf_lab.support.files import file_name, write_text
from tf_lab.support.layout import CONFIG, ORIGIN, PICTURES, mesh_path, picture_path

PICTURE = 900  # pixels across


def write_pages(
    study: Study, about: str, remarks: Sequence[str], output: Path, figures: Sequence[Path] = ()
) -> None:
    """Write ``report.html`` and ``pages/<run>.html``.

    Args:
        study: the runs.
        about: what was run.
        remarks: on it.
        output: the report's folder, with the pictures of the test scenes.
        figures: PNG files of this study, each with its caption beside it.
    """
    page = study_page(study, about, remarks, output / PICTURES, figures)
    write_text(output / "report.html", page)
    pages = {output / "pages" / f"{r.directory.name}.html": r for r in study.runs.values()}
    for path, run in pages.items():
        write_text(path, run_page(run))
    for path in {*(output / "pages").glob("*.html")} - pages.keys():
        path.unlink()  # of another study's report


def study_page(
    study: Study, about: str, remarks: Sequence[str], pictures: Path, figures: Sequence[Path] = ()
) -> str:
    """All of a study: tables, charts, the pictures that there are, a mesh, and its settings."""
    scenes = [pictures / f"{file_name(scene)}.png" for scene in study.scenes]
    drawn = [path for path in scenes if path.exists()]
    shown = scenes_of(study)
    mesh = ""
    if shown:
        scene, runs = next(iter(shown.items()))
        row, run = next(iter(runs.items()))
        caption = paragraph(f"{scene}, {row}, seed {run.seed}")
        mesh = caption + _mesh(mesh_path(run.directory, scene))
    return page(
        f"Study {study.key}",
        paragraph(about),
        *map(paragraph, remarks),
        section("Results", table_html(main_table(study))),
        section(
            "Charts",
            chart(views_chart(study), "F-score against K, the views kept a voxel"),
            chart(rows_chart(study), "F-score of every row"),
        ),
        section("A mesh", mesh),
        section("Test scenes", *(_preview(path) for path in drawn)),
        section("Figures", *map(_figure, figures)),
        section("Orderings", code(summary(study)), table_html(orderings_table(study))),
        section("Inputs", table_html(inputs_table(study))),
        section("Tests against ours", table_html(comparison_table(study))),
        section("Seeds", table_html(seed_table(study))),
        section("Scenes", table_html(scene_table(study))),
        section("Other settings", table_html(settings_table(study))),
        section("Settings", folded("What all runs share", _yaml(study.settings))),
        section("Runs", folded("The command of each", _commands(study))),
    )


def run_page(run: Run) -> str:
    """All of a run: scores, pictures, a mesh, the command, settings, and where it was made."""
    pictures = [picture_path(run.directory, scene) for scene in run.scenes]
    meshes = [mesh_path(run.directory, scene) for scene in run.scenes]
    first = next((path for path in meshes if path.exists()), None)
    view = "" if first is None else paragraph(first.stem) + _mesh(first)
    origin = without_places(run.makers[0])
    return page(
        f"{run.row}, seed {run.seed}",
        paragraph(run.directory.name),
        section("Scores", table_html(run_table(run))),
        section("A mesh", view),
        section("Test scenes", *(_preview(path) for path in pictures if path.exists())),
        section("The command that repeats it", code(str(origin.get("command", "unknown")))),
        section("Settings", folded(CONFIG, _yaml(portable_config(run.config)))),
        section("Where it was made", folded(ORIGIN, json.dumps(origin, indent=2))),
    )


def _mesh(path: Path) -> str:
    """A view of a mesh, or why there is none: the rest of a page can do without."""
    try:
        return mesh_view(read_mesh(path))
    except TFLabError as error:
        return paragraph(str(error))


def _preview(path: Path) -> str:
    return picture(preview(path, PICTURE), "jpeg", path.stem)


def _figure(path: Path) -> str:
    caption = path.with_suffix(".txt").read_text(encoding="utf-8").strip()
    return picture(preview(path, PICTURE), "jpeg", caption)


def _commands(study: Study) -> str:
    lines = (
        f"{run.row}, seed {run.seed}\n  {without_places(run.makers[0]).get('command', 'unknown')}"
        for run in study.runs.values()
    )
    return "\n".join(lines)


def _yaml(values: dict[str, object]) -> str:
    return yaml.safe_dump(values, sort_keys=False)
