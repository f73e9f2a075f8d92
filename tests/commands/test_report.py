"""`python -m tf_lab.report` as a user runs it, on made-up runs and on a real one."""

import csv
import functools
import json
import shutil
from pathlib import Path

import pytest
import yaml
from PIL import Image

from helpers.made_up_runs import ROWS, write_run, write_study
from helpers.tiny_jobs import Result, call
from tf_lab.reporting import gallery
from tf_lab.reporting.paper import SCORES

FILES = {
    *("tables.md", "orderings.md", "runs.csv", "report.html", "pages"),
    *(f"{n}.csv" for n in ("main", "inputs", "comparison", "orderings", "seeds", "scenes")),
    *(f"table_{n}.tex" for n in ("main", "inputs", "comparison", "orderings", "seeds", "scenes")),
    *(f"chart_{name}.{kind}" for name in ("views", "rows") for kind in ("png", "pdf")),
}


def test_a_whole_study(tmp_path: Path) -> None:
    write_study(tmp_path / "outputs", {row: SCORES[row]["fscore"] for row in ROWS})
    done = call("report")  # by default of outputs/runs
    assert (done.status, done.err) == (0, "")
    assert {path.name for path in (tmp_path / "outputs" / "report").iterdir()} == FILES
    lines = [line.split("|") for line in done.out.splitlines() if line.startswith("| Ours")]
    assert [line[1].strip() for line in lines] == [*ROWS]
    assert lines[-1][7].strip().startswith("**0.655** ± ")
    assert "each row under ours: 11 of 11 hold in the mean" in done.out


def test_a_part_of_a_study(tmp_path: Path) -> None:
    write_run(tmp_path, "", 0, [0.5, 0.6])
    write_run(tmp_path, "views=8", 0, [0.5, 0.6])
    bad = write_run(tmp_path, "", 1, [0.5, 0.6])
    (bad / "metrics.json").write_text("{")
    done = call("report", f"runs={tmp_path}/runs", f"output={tmp_path}/report")
    assert (done.status, done.err) == (0, "")
    assert "Missing: Ours: w/o TRSF, avg; " in done.out
    assert f"left out: {bad}/metrics.json: damaged" in done.out
    assert {path.name for path in (tmp_path / "report").iterdir()} == FILES
    with (tmp_path / "report" / "main.csv").open() as file:
        rows = {row["row"]: row for row in csv.DictReader(file)}
    assert float(rows["Ours"]["fscore"]) == pytest.approx(0.55)
    assert rows["Ours: 4 images"]["fscore"] == ""
    assert "fscore_deviation" not in rows["Ours"]
    assert f"left out: {bad}" in (tmp_path / "report" / "tables.md").read_text()


@pytest.mark.parametrize("name", ["Ours", "Ours: 4 images"])
def test_a_single_run(tmp_path: Path, name: str) -> None:
    """What was not run is counted, and fills no table; nor do those of an earlier report stay."""
    output = tmp_path / "report"
    write_study(tmp_path / "outputs", {row: SCORES[row]["fscore"] for row in ROWS}, seeds=[0])
    assert call("report", f"output={output}").status == 0
    run = write_run(tmp_path / "one", ROWS[name], 0, [0.5, 0.6])
    done = call("report", f"runs={run}", f"output={output}")
    assert (done.status, done.err) == (0, "")
    (line,) = (line for line in done.out.splitlines() if "no run yet" in line)
    assert "1 run of 1 row" in line and "11 of the paper's 12 rows have no run yet." in line
    assert "issing" not in done.out
    tables = ("inputs", "comparison", "orderings")
    without = {name for n in tables for name in (f"{n}.csv", f"table_{n}.tex")}
    assert {path.name for path in output.iterdir()} == FILES - without
    with (output / "main.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert (row["row"], row["fscore"]) == (name, "0.55")
    assert float(row["paper_fscore"]) == SCORES[name]["fscore"]
    for page in ("tables.md", "orderings.md", "report.html"):
        text = (output / page).read_text()
        assert "RND" not in text.partition("Charts")[0] and "issing" not in text


def test_no_runs(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    done = call("report", f"runs={tmp_path}/runs")
    assert done.status == 2
    assert done.err.startswith(f"error: no finished run in {tmp_path}/runs; run: python -m tf_lab.")
    assert len(done.err.splitlines()) == 1
    assert "no such folder" in call("report").err  # outputs/runs
    (tmp_path / "a.json").write_text("")
    assert "a.json: is no folder" in call("report", f"runs={tmp_path}/a.json").err
    assert "runs=[]: give a folder" in call("report", "runs=[]").err
    told = call("report", f"output={tmp_path}").err
    assert f"the runs in it are given by runs={tmp_path / 'runs'}" in told


def test_another_report_into_the_same_folder(tmp_path: Path) -> None:
    """Of the one before no page is left; runs that were kept stay, and are told."""
    runs = [write_run(tmp_path / str(i), f"optimizer.steps={7 + i}", 0, [0.5]) for i in range(2)]
    words = (f"output={tmp_path}/out", "keep=true", "figures=[]", "pictures=false")
    for run in runs:
        done = call("report", f"runs={run.parent}", *words)
        assert done.status == 0
    assert [path.stem for path in (tmp_path / "out" / "pages").iterdir()] == [runs[1].name]
    assert {path.name for path in (tmp_path / "out" / "runs").iterdir()} == {r.name for r in runs}
    assert f"keeps 1 run more, of which this report has nothing, such as {runs[0].name}" in done.out


def test_several_folders_and_the_study_asked_for(tmp_path: Path) -> None:
    for folder, steps in (("a", 7), ("b", 7), ("c", 8)):
        write_run(tmp_path / folder, f"optimizer.steps={steps}", ord(folder), [0.5])
    runs = f"runs=[{tmp_path}/a,{tmp_path}/b,{tmp_path}/c]"
    done = call("report", runs, "pictures=false")
    assert "2 runs of 1 row, seeds 97, 98;" in done.out
    (line,) = (line for line in done.out.splitlines() if line.startswith("left out: study"))
    assert "optimizer.steps 8 (not 7)" in line
    (beside,) = (line for line in done.out.splitlines() if "| optimizer.steps 8 (not 7) |" in line)
    assert "0.500" in beside
    key = line.split()[3].rstrip(",")
    assert "1 run of 1 row, seed 99;" in call("report", runs, f"study={key}").out


def test_kept_results_give_the_same_report(tmp_path: Path) -> None:
    write_study(tmp_path / "outputs", {"Ours": 0.6, "Ours: 4 images": 0.5})
    other = write_run(tmp_path / "outputs", "optimizer.steps=7", 0, [0.5])  # of fewer scenes
    beside = write_run(tmp_path / "outputs", "optimizer.steps=8", 0, [0.5, 0.6, 0.7, 0.8])
    kept = tmp_path / "results" / "reference"
    assert call("report", f"output={kept}", "keep=true").status == 0
    assert len([*(kept / "runs").iterdir()]) == 7
    assert (kept / "runs" / beside.name).exists() and (kept / "settings.csv").exists()
    assert not (kept / "runs" / other.name).exists()
    for path in filter(Path.is_file, kept.rglob("*.*")):
        assert str(tmp_path).encode() not in path.read_bytes(), path
    first = {
        name: (kept / name).read_bytes()
        for name in FILES - {"tables.md", "report.html"}  # they say what was left out
        if (kept / name).is_file()
    }
    shutil.rmtree(tmp_path / "outputs")
    (kept / "pictures").mkdir()
    (kept / "pictures" / "room.png").write_bytes(b"drawn before")
    assert call("report", f"runs={kept}/runs", f"output={kept}").status == 0
    assert {name: (kept / name).read_bytes() for name in first} == first
    assert (kept / "pictures" / "room.png").read_bytes() == b"drawn before"
    (line,) = (t for t in (kept / "tables.md").read_text().splitlines() if "left out" in t)
    assert "optimizer.steps 8" in line


def test_a_real_run(
    main_job: Result, outputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the train command leaves is read, and its room is drawn beside its ground truth."""
    run = outputs.parent / main_job.path("run")
    shutil.copytree(run, tmp_path / "outputs" / "runs" / run.name)
    small = functools.partial(gallery.draw_pictures, size=(96, 72))
    monkeypatch.setattr("tf_lab.reporting.gallery.draw_pictures", small)
    done = call("report", "keep=true")
    assert done.status == 0, done.err
    metrics = json.loads((run / "metrics.json").read_text())
    (line,) = (line for line in done.out.splitlines() if line.startswith("| Ours"))
    assert line.split("|")[7].strip() == f"{metrics['mean']['fscore']:.3f}"
    report = tmp_path / "outputs" / "report"
    with Image.open(report / "pictures" / "room_2000000.png") as picture:
        assert picture.width > 900  # two panels: ground truth and ours
    kept = report / "runs" / run.name
    assert "root" not in yaml.safe_load((kept / "config.yaml").read_text())["data"]
    assert str(outputs) not in (kept / "run.json").read_text()
