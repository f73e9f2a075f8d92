"""All finished runs as the paper's tables and charts, beside the paper's numbers."""

from __future__ import annotations

from pathlib import Path

import trimesh

from tf_lab.config.schema import ReportConfig
from tf_lab.data.sources.source import open_source
from tf_lab.meshes.files import read_mesh
from tf_lab.reporting.formats import markdown
from tf_lab.reporting.gallery import draw_scene, scene_runs
from tf_lab.reporting.orderings import summary
from tf_lab.reporting.report import describe, write_report
from tf_lab.reporting.results import Run, keep_run
from tf_lab.reporting.studies import Study, open_study
from tf_lab.reporting.tables import short_table
from tf_lab.support.files import check_folder
from tf_lab.support.progress import progress_bar


def run(config: ReportConfig) -> None:
    """Read the runs; print the main table; write tables, orderings, charts and pictures."""
    folders = [config.runs] if isinstance(config.runs, str) else config.runs
    output = Path(config.output)
    check_folder(output)
    study, remarks = open_study(folders, config.study)
    if config.keep:
        for run in study.runs.values():
            keep_run(run, output / "runs")
    write_report(study, remarks, output)
    pictures = draw_pictures(study, output / "pictures") if config.pictures else 0
    print(describe(study), *remarks, markdown(short_table(study)), summary(study), sep="\n\n")
    print(f"\n{output}: tables.md, orderings.md, charts, and {pictures} pictures of test scenes")


def draw_pictures(study: Study, folder: Path) -> int:
    """Draw the test scenes of which there are meshes; of the others what is there stays."""
    shown = {scene: runs for scene in study.scenes if (runs := scene_runs(study, scene))}
    with progress_bar() as bar:
        for scene, runs in bar.track(shown.items(), description="drawing"):
            truth = groundtruth_mesh(next(iter(runs.values())), scene)
            draw_scene(runs, scene, truth, folder / f"{scene}.png")
    return len(shown)


def groundtruth_mesh(run: Run, scene: str) -> trimesh.Trimesh | None:
    """The ground truth of a run's test scene, if it is on this machine."""
    if not run.config.data.root:  # a kept copy
        return None
    digest = run.makers[0].get("scenes", {}).get(scene)
    directory = open_source(run.config.data).directory(scene, digest)
    path = directory / "groundtruth" / "mesh_gt.ply"
    return read_mesh(path) if path.exists() else None
