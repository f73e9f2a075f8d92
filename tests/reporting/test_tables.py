"""The tables hold the numbers that the runs were made of, in every format."""

import csv
import io
import json
import re
import statistics
from pathlib import Path

import numpy as np
import pytest

from helpers.made_up_runs import ROWS, SCENES, change_scores, write_run, write_study
from tf_lab.reporting.formats import Column, Number, Table, comma_separated, latex, markdown
from tf_lab.reporting.paper import ABLATIONS, MAIN, SCORES
from tf_lab.reporting.studies import Study, open_study
from tf_lab.reporting.tables import (
    _with_best,
    comparison_table,
    inputs_table,
    main_table,
    orderings_table,
    runs_table,
    scene_table,
    seed_table,
    settings_table,
    short_table,
    views_table,
)

ALL = (
    *(main_table, inputs_table, comparison_table, orderings_table),
    *(seed_table, scene_table, runs_table, short_table),
)


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    """All rows with three seeds, but: one row without a run, one with one seed, one of our own."""
    output = tmp_path_factory.mktemp("outputs")
    means = {row: SCORES[row]["fscore"] for row in ROWS}
    del means["Ours: w/o view ray"]
    single = {"Ours: w/o C2F filter": means.pop("Ours: w/o C2F filter")}
    write_study(output, means)
    write_study(output, single, seeds=[0])
    for seed in range(3):
        write_run(output, "fusion=avg refine=false", seed, [0.2, 0.3, 0.4, 0.5])
    return open_study([output])[0]


def cells(table: Table) -> dict[str, list[str]]:
    """The cells of the Markdown by the first of their row."""
    _, _, *lines = markdown(table).splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return {row[0]: row[1:] for row in rows}


def records(table: Table) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(comma_separated(table))))


def test_mean_and_deviation_over_seeds(study: Study) -> None:
    means = []
    for seed in range(3):
        scenes = study.runs["Ours", seed].scenes.values()
        means.append(statistics.fmean(scene["fscore"] for scene in scenes))
    mean, spread = statistics.fmean(means), statistics.stdev(means)
    assert mean == pytest.approx(0.655)  # as it was made
    assert cells(main_table(study))["Ours"][6] == f"**{mean:.3f}** ± {spread:.3f}"
    (record,) = (r for r in records(main_table(study)) if r["row"] == "Ours")
    assert float(record["fscore"]) == pytest.approx(mean, abs=1e-6)
    assert float(record["fscore_deviation"]) == pytest.approx(spread, abs=1e-6)
    assert float(record["paper_fscore"]) == 0.655


def test_other_settings_are_paired_by_seed_and_scene(tmp_path: Path) -> None:
    first, second = np.random.default_rng(0).uniform(0.3, 0.7, (2, 4, 4))
    for seed in range(4):
        write_run(tmp_path, "", seed, first[seed].tolist())
        write_run(tmp_path, "views=4", seed, second[seed].tolist())
        if seed >= 2:
            better = (second[seed] + 0.1).tolist()
            write_run(tmp_path, "views=4 optimizer.steps=7", seed, better)
    write_run(tmp_path, "optimizer.steps=8", 9, first[0].tolist())  # a seed that nothing else has
    study, _ = open_study([tmp_path])
    steps = study.settings["optimizer.steps"]
    four, ours = records(settings_table(study))
    assert (four["row"], four["seeds"]) == ("Ours: 4 images", "2")
    assert four["settings"] == f"optimizer.steps 7 (not {steps})"
    assert float(four["fscore"]) == pytest.approx(second[2:].mean() + 0.1, abs=1e-6)
    assert float(four["here"]) == pytest.approx(second[2:].mean(), abs=1e-6)
    for bound in ("difference", "low", "high"):
        assert float(four[bound]) == pytest.approx(0.1, abs=1e-6)
    assert (ours["row"], ours["seeds"]) == ("Ours", "1")
    assert float(ours["fscore"]) == pytest.approx(first[0].mean(), abs=1e-6)
    assert ours["here"] == ours["difference"] == ours["p"] == ""
    assert "of one seed they are of scenes alone" in settings_table(study).caption


def test_nothing_is_beside_a_study_alone(study: Study) -> None:
    assert settings_table(study).groups == ()


def test_the_main_table_is_laid_out_as_the_papers(study: Study) -> None:
    table = main_table(study)
    own = "Ours: w/o TRSF, avg, w/o spatial ref."
    inputs = ("Ours: w/o projected depth", "Ours: w/o view ray")
    ablations = [row for row in ABLATIONS if row not in inputs]
    assert [[row[0] for row in group] for group in table.groups] == [
        *([*MAIN[0]], ablations, ["Ours"], [own])
    ]
    found = cells(table)
    assert found["Atlas"][:7] == ["-"] * 7
    assert found["Atlas"][7:] == ["7.16", "7.61", "7.38", "0.675", "0.605", "0.636"]
    assert found[own][6] == "0.350 ± 0.000"
    assert found[own][7:] == ["-"] * 6
    assert found["Ours: w/o C2F filter"][6] == "0.631"  # one seed: no deviation
    assert cells(inputs_table(study))["Ours: w/o view ray"][:7] == ["-"] * 7  # missing


def test_how_many_seeds_a_row_has_where_they_differ(study: Study, tmp_path: Path) -> None:
    found = cells(short_table(study))
    assert (found["Ours"][0], found["Ours: w/o C2F filter"][0]) == ("3", "1")
    assert "over seeds 0, 1, 2, of some rows fewer, of the mean" in main_table(study).caption
    odd = [("", 0), ("", 1), ("fusion=avg", 1), ("fusion=avg", 2)]
    for row, seed in odd:
        write_run(tmp_path / "odd", row, seed, [0.5])
    table = main_table(open_study([tmp_path / "odd"])[0])
    assert "Seeds" in [column.title for column in table.columns]
    assert "those of the seeds 0, 1, 2 that a row has, none all of them," in table.caption
    said = "of one seed they are of scenes alone, and say nothing of another training"
    assert said in comparison_table(study).caption and said in orderings_table(study).caption
    write_study(tmp_path, {row: SCORES[row]["fscore"] for row in ROWS})
    whole = open_study([tmp_path])[0]
    assert "Seeds" not in [column.title for column in main_table(whole).columns]
    assert said not in comparison_table(whole).caption + orderings_table(whole).caption
    write_run(tmp_path / "one", "", 0, [0.5])
    one = main_table(open_study([tmp_path / "one"])[0]).caption
    assert one.startswith("Of seed 0 the mean over 1 test scene; distances in cm.")


def test_the_best_is_bold(study: Study) -> None:
    """In the paper's columns just what the paper has in bold; in ours the made-up best."""
    found = cells(main_table(study))
    bold = {(row, i) for row, line in found.items() for i, c in enumerate(line) if "**" in c}
    assert {(row, i - 7) for row, i in bold if i >= 7} == {
        *(("NeuralRecon", 0), ("DeepVideoMVS", 1), ("Ours", 2)),
        *(("Ours", 3), ("NeuralRecon", 4), ("Ours", 5)),
    }
    assert {(row, i) for row, i in bold if i < 7} == {("Ours", i) for i in range(1, 7)}


def test_equals_are_equally_good(tmp_path: Path) -> None:
    write_run(tmp_path, "", 0, [0.60001])
    write_run(tmp_path, "views=8", 0, [0.60004])
    write_run(tmp_path, "views=4", 0, [0.59])
    found = cells(short_table(open_study([tmp_path])[0]))
    assert found["Ours"][5] == found["Ours: 8 images"][5] == "**0.600**"
    assert found["Ours: 4 images"][5] == "0.590"


@pytest.mark.parametrize("form", [".1%", ",.1f"])
def test_the_best_of_numbers_however_they_are_printed(form: str) -> None:
    columns = (Column("name", "N"), Column("p", "p", "up"))
    body = [[("a", Number(1234.0, form)), ("b", Number(5.0, form))]]
    ((first, second),) = _with_best(body, columns)
    assert (first[1].best, second[1].best) == (True, False)


def test_a_row_without_a_surface_is_best_at_nothing(tmp_path: Path) -> None:
    write_run(tmp_path, "", 0, [0.6])
    empty = write_run(tmp_path, "views=8", 0, [0.0])
    change_scores(empty, prec=1.0)
    write_run(tmp_path, "views=4", 0, [0.5])
    found = cells(short_table(open_study([tmp_path])[0]))
    assert found["Ours: 8 images"][3] == "1.000"
    assert found["Ours"][3] == "**0.640**"
    beside = cells(main_table(open_study([tmp_path])[0]))
    assert "**0.655**" in beside["Ours"]  # the paper's, which are no less there


def test_the_papers_numbers_count_beside_a_row_without_a_surface(tmp_path: Path) -> None:
    for overrides, fscore in (("", 0.0), ("views=8", 0.0), ("views=4", 0.1)):
        write_run(tmp_path, overrides, 0, [fscore])
    found = cells(main_table(open_study([tmp_path])[0]))
    assert [row for row, line in found.items() if "**" in line[-1]] == ["Ours"]


def test_where_all_are_equal_none_is_best(tmp_path: Path) -> None:
    for overrides in ("", "views=8"):
        write_run(tmp_path, overrides, 0, [0.5])
    found = cells(short_table(open_study([tmp_path])[0]))
    assert "**" not in "".join(found["Ours"] + found["Ours: 8 images"])


def test_comparison(study: Study) -> None:
    found = {record["row"]: record for record in records(comparison_table(study))}
    record = found["Ours: w/o TRSF, avg"]
    assert float(record["difference"]) == pytest.approx(0.557 - 0.655)
    assert float(record["paper"]) == pytest.approx(0.557 - 0.655)
    assert float(record["low"]) < -0.098 < float(record["high"]) < 0
    assert float(record["p"]) < 0.05
    assert (record["seeds"], found["Ours: w/o C2F filter"]["seeds"]) == ("3", "1")
    assert found["Ours"]["difference"] == ""
    assert found["Ours: w/o TRSF, avg, w/o spatial ref."]["paper"] == ""


def test_a_comparison_is_of_the_seeds_that_both_have(tmp_path: Path) -> None:
    write_run(tmp_path, "", 0, [0.6, 0.7])
    for seed, fscore in enumerate((0.5, 0.1, 0.1)):
        write_run(tmp_path, "fusion=avg", seed, [fscore, fscore])
    found = cells(comparison_table(open_study([tmp_path])[0]))["Ours: w/o TRSF, avg"]
    assert found[:3] == ["1", "0.500", "-0.150"]


def test_details(study: Study) -> None:
    (record,) = (r for r in records(seed_table(study)) if r["row"] == "Ours: w/o C2F filter")
    assert float(record["seed_0"]) == float(record["mean"]) == pytest.approx(0.631)
    assert record["seed_1"] == ""
    (record,) = (
        r for r in records(scene_table(study)) if r["row"].endswith("avg, w/o spatial ref.")
    )
    assert [float(record[scene]) for scene in SCENES] == pytest.approx([0.2, 0.3, 0.4, 0.5])
    rows = records(runs_table(study))
    assert len(rows) == len(study.runs) * len(SCENES)
    first = study.runs[rows[0]["row"], 0].scenes[SCENES[0]]
    assert float(rows[0]["fscore"]) == pytest.approx(first["fscore"], abs=1e-6)
    assert len(records(runs_table(study, "Ours"))) == 3 * len(SCENES)


def test_what_views_are_worth_by_row(tmp_path: Path) -> None:
    """Means over scenes, then over seeds; rows of runs that did not measure it are left out."""
    for seed, shares in enumerate(((0.5, 0.7), (0.8, 0.8))):
        path = write_run(tmp_path, "", seed, [0.5, 0.6]) / "metrics.json"
        metrics = json.loads(path.read_text())
        sets = [
            {"visible": v, "visible_of_all": 0.4, "spread": 20, "variety": 9, "views": 4}
            for v in shares
        ]
        names = metrics["scenes"]
        metrics["details"] = {n: {"view_sets": s} for n, s in zip(names, sets, strict=True)}
        path.write_text(json.dumps(metrics))
    write_run(tmp_path, "views=4", 0, [0.5, 0.6])
    study, _ = open_study([tmp_path])
    assert cells(views_table(study)) == {
        "Ours": ["0.700 ± 0.141", "0.400 ± 0.000", "20.0 ± 0.0", "9.0 ± 0.0", "0.550 ± 0.000"]
    }


def test_views_of_which_a_run_says_too_little_are_left_out(tmp_path: Path) -> None:
    """A scene without them, or one of them."""
    whole = {"visible": 0.5, "visible_of_all": 0.4, "spread": 20, "variety": 9}
    part = {"visible": 0.5}
    for name, sets in {"scene": [whole], "one": [part, part], "none": [whole, whole]}.items():
        path = write_run(tmp_path / name, "", 0, [0.5, 0.6]) / "metrics.json"
        metrics = json.loads(path.read_text())
        metrics["details"] = {n: {"view_sets": s} for n, s in zip(SCENES, sets, strict=False)}
        path.write_text(json.dumps(metrics))
        study, _ = open_study([tmp_path / name])
        assert [*cells(views_table(study))] == (["Ours"] if name == "none" else [])


def test_metrics_that_only_some_runs_have(tmp_path: Path) -> None:
    """Missing ones are dashes, further ones columns; a mean is over the seeds that have it."""
    for seed, normals in enumerate((0.8, 0.9)):
        change_scores(write_run(tmp_path, "", seed, [0.5]), "recall", normals=normals)
    write_run(tmp_path, "", 2, [0.5])
    change_scores(write_run(tmp_path, "fusion=avg", 0, [0.5]), "fscore")
    study, remarks = open_study([tmp_path])
    told = re.findall(r"^(.*, seed \d): .* lacks (\w*) of a", "\n".join(remarks), re.MULTILINE)
    assert sorted(told) == [
        ("Ours, seed 0", "recall"),
        ("Ours, seed 1", "recall"),
        ("Ours: w/o TRSF, avg, seed 0", "fscore"),
    ]
    for make in (short_table, main_table):
        columns = [column.title for column in make(study).columns]
        assert columns[2:9] == ["Acc", "Compl", "Chamfer", "Prec", "Recall", "F-score", "Normals"]
        assert make(study).columns[8].better == "up"
        found = cells(make(study))
        assert found["Ours"][5].strip("*") == "0.460"  # of one seed
        assert found["Ours"][7] == "0.850 ± 0.071"  # of two
        assert found["Ours: w/o TRSF, avg"][6:8] == ["-", "-"]
    assert cells(seed_table(study))["Ours: w/o TRSF, avg"] == ["-"] * 4
    assert cells(scene_table(study))["Ours: w/o TRSF, avg"] == ["-"]
    assert cells(comparison_table(study))["Ours: w/o TRSF, avg"][1:6] == ["-"] * 5
    found = cells(orderings_table(study))["Ours: w/o TRSF, avg < Ours"]
    assert found == ["0", "0", *["-"] * 5, "+0.098", "missing", "missing"]
    first, second, third, other = records(runs_table(study))[1:] + records(runs_table(study))[:1]
    assert [r["normals"] for r in (first, second, third)] == ["0.8", "0.9", ""]
    assert (first["recall"], third["recall"], other["fscore"]) == ("", "0.46", "")


def test_missing_rows_are_said(study: Study) -> None:
    found = cells(orderings_table(study))["Ours: w/o view ray < Ours"]
    assert found == ["0", "0", *["-"] * 5, "+0.034", "missing", "missing"]


def latex_cells(line: str) -> int:
    """The columns a row of LaTeX fills."""
    spans = [int(n) - 1 for n in re.findall(r"\\multicolumn\{(\d+)\}", line)]
    return len(re.findall(r"(?<!\\)&", line)) + 1 + sum(spans)


@pytest.mark.parametrize("make", ALL)
def test_latex_is_well_formed(study: Study, make) -> None:
    table = make(study)
    text = latex(table)
    code = re.sub(r"\\[\\{}$%&_#]", "", re.sub(r"(?m)^%.*$", "", text))  # without escapes
    depth = 0
    for character in code:
        depth += (character == "{") - (character == "}")
        assert depth >= 0
    assert depth == 0
    assert code.count("$") % 2 == 0
    begun = re.findall(r"\\begin\{(\w+)\}", text)
    assert begun == re.findall(r"\\end\{(\w+)\}", text)[::-1] == ["table", "tabular"]
    (layout,) = re.findall(r"\\begin\{tabular\}\{(\w+)\}", text)
    assert len(layout) == len(table.columns)
    rows = [line for line in text.splitlines() if line.endswith(r"\\")]
    assert {latex_cells(line) for line in rows} == {len(layout)}
    spans = any(column.span for column in table.columns)
    assert len(rows) == 1 + spans + sum(map(len, table.groups))
    assert text.count(r"\midrule") == len(table.groups)
    for end in re.findall(r"\\cmidrule\(lr\)\{\d+-(\d+)\}", text):
        assert int(end) <= len(layout)
    assert text.isascii()


@pytest.mark.parametrize("make", ALL)
def test_markdown_is_aligned(study: Study, make) -> None:
    lines = markdown(make(study)).splitlines()
    assert len({len(line) for line in lines}) == 1
    assert len({line.count("|") for line in lines}) == 1


def test_a_narrow_column_has_a_rule_that_markdown_takes() -> None:
    table = Table("t", "", (Column("name", "N"), Column("p", "p")), ((("a", Number(None)),),))
    assert markdown(table).splitlines()[1] == "| :- | -: |"


def test_numbers_and_text_in_every_format() -> None:
    table = Table(
        "t",
        "A 5 % test & more.",
        (Column("name", "Name"), Column("score", "Score", "up"), Column("word", "my_word")),
        (
            (("a_b & c", Number(0.12345, deviation=0.0011, best=True), "x < y"),),
            (("d", Number(-0.5, "+.2f"), ""), ("e", Number(None), "z")),
        ),
    )
    assert markdown(table).splitlines() == [
        "| Name    |           Score ↑ | my_word |",
        "| :------ | ----------------: | ------: |",
        "| a_b & c | **0.123** ± 0.001 |   x < y |",
        "| d       |             -0.50 |       - |",
        "| e       |                 - |       z |",
    ]
    text = latex(table)
    assert r"a\_b \& c & $\mathbf{0.123}_{\pm 0.001}$ & x $<$ y \\" in text
    assert r"d & $-0.50$ & -- \\" in text
    assert r"\caption{A 5 \% test \& more.}" in text
    assert comma_separated(table).splitlines() == [
        "name,score,score_deviation,word",
        "a_b & c,0.12345,0.0011,x < y",
        "d,-0.5,,",
        "e,,,z",
    ]
