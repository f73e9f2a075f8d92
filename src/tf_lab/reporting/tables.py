"""The tables of a study: the paper's, the tests against ours, the orderings, and the details."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from tf_lab.evaluation.registry import MetricPart, metric_columns
from tf_lab.evaluation.scores import mean_scores
from tf_lab.reporting.formats import Cell, Column, Number, Row, Table
from tf_lab.reporting.orderings import Ordering, difference, orderings_of, verdict
from tf_lab.reporting.paper import ABLATIONS, INPUTS, MAIN, OURS, SCORES
from tf_lab.reporting.results import Run
from tf_lab.reporting.statistics import Estimate, deviation, estimate, holm
from tf_lab.reporting.studies import Study, differences
from tf_lab.support.words import counted

ROW = Column("row", "Method")
HERE, THERE = "This study", "Paper"
PAPERS = "paper"  # begins the keys of the paper's columns
SCORE = Column("fscore", "F-score", "up")
SEEDS = Column("seeds", "Seeds")
HERE_SCORE = Column("here", "In this study", "up")
ONE_SEED = "of one seed they are of scenes alone, and say nothing of another training"
ONE_SCENE = "of one scene they are of trainings alone, and say nothing of another scene"
INTERVAL = (
    Column("difference", "Difference"),
    Column("low", "95 % from"),
    Column("high", "to"),
    Column("p", "p"),
)


def main_table(study: Study) -> Table:
    """The paper's main table, and after it the rows that the paper does not have."""
    others = [row for row in study.rows if row not in (*ABLATIONS, OURS)]
    return _beside_paper(study, "main", [*map(list, MAIN), others])


def inputs_table(study: Study) -> Table:
    """The paper's ablation of the transformers' inputs, which ours alone is not."""
    groups = [] if study.rows == [OURS] else [[*group] for group in INPUTS]
    return _beside_paper(study, "inputs", groups)


def short_table(study: Study) -> Table:
    """All rows that were run, with the paper's F-score only: fits a terminal."""
    columns = (ROW, *_seeds(study), *_metrics(study.metrics), Column("paper", "Paper's F"))
    body: list[Row] = [
        (row, *_mean_cells(study, row), Number(SCORES.get(row, {}).get("fscore")))
        for row in study.rows
    ]
    return Table("rows", "", columns, _with_best([body], columns))


def _beside_paper(study: Study, name: str, groups: Sequence[Sequence[str]]) -> Table:
    theirs = [replace(c, key=f"{PAPERS}_{c.key}") for c in _metrics(metric_columns(), THERE)]
    columns = (ROW, *_seeds(study), *_metrics(study.metrics, HERE), *theirs)
    body: list[list[Row]] = [
        [(row, *_mean_cells(study, row), *_paper_cells(row)) for row in group if study.shows(row)]
        for group in groups
    ]
    scenes = counted(len(study.scenes), "test scene")
    caption = (
        f"{_over(study)} the mean over {scenes}; distances in cm. "
        f"Beside it the paper's figures, which are {_theirs(study)}"
    )
    return Table(name, caption, columns, _with_best(body, columns))


def _theirs(study: Study) -> str:
    """What the paper's figures are of, and what of them compares."""
    tested = study.settings.get("test.data.name") or study.settings.get("data.name")
    if tested == "scannet":
        given = study.settings.get("test.content.groundtruth") is not None
        compare = "if it is what was given" if given else "by that alone"
        return (
            f"of all 100 test scenes and the authors' ground truth: values compare {compare} "
            "(`groundtruth=`)."
        )
    return "of ScanNet: only orders compare, not values."


def _metrics(parts: Sequence[MetricPart], span: str = "") -> list[Column]:
    better = {True: "up", False: "down", None: ""}
    return [Column(p.name, p.heading, better[p.higher_is_better], span) for p in parts]


def _over(study: Study) -> str:
    """What a main table shows of the seeds."""
    seeds = ", ".join(map(str, study.seeds()))
    if len(study.seeds()) == 1:
        return f"Of seed {seeds}"
    if not _seeds(study):
        which = f"seeds {seeds}"
    elif any(study.seeds(row) == study.seeds() for row in study.rows):
        which = f"seeds {seeds}, of some rows fewer,"
    else:
        which = f"those of the seeds {seeds} that a row has, none all of them,"
    return f"Mean and standard deviation over {which} of"


def _seeds(study: Study) -> list[Column]:
    """A column for how many seeds a row has, where they are not the same for all."""
    alike = all(study.seeds(row) == study.seeds() for row in study.rows)
    return [] if alike else [SEEDS]


def _mean_cells(study: Study, row: str) -> list[Cell]:
    """Mean and deviation over seeds of each metric; nothing where no run of the row has it.

    Before them the number of seeds, where there is a column for it.
    """
    scores = [_over_seeds(study.scores(row, p.name).mean(1), p.format) for p in study.metrics]
    seeds = Number(len(study.seeds(row)) or None, "d")
    return [seeds, *scores] if _seeds(study) else [*scores]


def _over_seeds(means: np.ndarray, form: str = ".3f") -> Number:
    return Number(float(means.mean()), form, deviation(means)) if len(means) else Number(None)


def _paper_cells(row: str) -> list[Number]:
    return [Number(SCORES.get(row, {}).get(part.name), part.format) for part in metric_columns()]


def _with_best(
    body: Sequence[Sequence[Row]], columns: Sequence[Column]
) -> tuple[tuple[Row, ...], ...]:
    """The rows with the best of each column marked; what is equal as printed is equally good.

    Where all are equal none is best, nor is a row without a surface, whatever its precision; the
    paper's numbers beside it are not its own.
    """
    scores = [i for i, column in enumerate(columns) if column.key == "fscore"]

    def counts(row: Row, column: Column) -> bool:
        values = [_value(row[i]) for i in scores]
        return column.key.startswith(PAPERS) or all(v is None or v > 0 for v in values)

    best: list[str | None] = []
    for i, column in enumerate(columns):
        cells = [row[i] for group in body for row in group if counts(row, column)]
        shown = {_printed(cell): value for cell in cells if (value := _value(cell)) is not None}
        pick = {"down": min, "up": max}.get(column.better)
        best.append(pick(shown, key=shown.__getitem__) if pick and len(shown) > 1 else None)

    def marked(row: Row) -> Row:
        return tuple(
            replace(cell, best=True)
            if isinstance(cell, Number)
            and winner
            and _printed(cell) == winner
            and counts(row, column)
            else cell
            for cell, winner, column in zip(row, best, columns, strict=True)
        )

    return tuple(tuple(map(marked, group)) for group in body)


def _printed(cell: Cell) -> str | None:
    """The number of a cell as it is printed, without its deviation; None: it has none."""
    return (cell.parts()[0] or None) if isinstance(cell, Number) else None


def _value(cell: Cell) -> float | None:
    return cell.value if isinstance(cell, Number) and cell.parts()[0] else None


def comparison_table(study: Study) -> Table:
    """Each row's F-score against ours, paired over seeds and scenes; of one row alone, nothing."""
    columns = (ROW, SEEDS, SCORE, *INTERVAL, Column("paper", "Paper"))
    body: list[Row] = []
    for row in [] if study.alone else study.rows:
        found = difference(study, {row: 1, OURS: -1}) if row != OURS else None
        known = row in SCORES and row != OURS
        theirs = SCORES[row]["fscore"] - SCORES[OURS]["fscore"] if known else None
        paired = study.seeds(row, OURS, metric="fscore")  # what the difference is of
        seeds = paired or study.seeds(row, metric="fscore")
        score = _over_seeds(study.scores(row, seeds=seeds).mean(1))
        differs = (*_interval_cells(found), Number(theirs, "+.3f"))
        body.append((row, str(len(seeds)), score, *differs))
    caption = (
        "F-score of each row against ours: mean difference, 95 % interval and p-value of a crossed "
        "bootstrap over seeds and test scenes (p-values are not corrected for their number"
        f"{_of_one(study)}), and the paper's difference."
    )
    return Table("comparison", caption, columns, _with_best([body], columns))


def settings_table(study: Study) -> Table:
    """The same rows otherwise: another encoder, more steps, a different threshold.

    A row for each of the studies whose scores compare, paired with this one's by seed and scene.
    """
    columns = (ROW, Column("settings", "Settings"), SEEDS, SCORE, HERE_SCORE, *INTERVAL)
    body: list[tuple[Row, ...]] = []
    for row in study.rows:
        others = [other for other in study.others if row in other.rows]
        body += [tuple(_otherwise(study, other, row) for other in others)] if others else []
    caption = (
        "F-score of rows with other settings, and with this study's by the same seeds: mean "
        "difference, 95 % interval and p-value of a crossed bootstrap over seeds and test scenes "
        f"(p-values are not corrected for their number{_of_one(study, *study.others)})."
    )
    return Table("settings", caption, columns, tuple(body))


def _otherwise(study: Study, other: Study, row: str) -> Row:
    mine, theirs = (each.seeds(row, metric="fscore") for each in (study, other))
    paired = [seed for seed in theirs if seed in mine]
    seeds = paired or theirs
    scores = other.scores(row, seeds=seeds)
    here = study.scores(row, seeds=paired)
    return (
        row,
        differences(other.settings, study.settings),
        str(len(seeds)),
        _over_seeds(scores.mean(1)),
        _over_seeds(here.mean(1)),
        *_interval_cells(estimate(scores - here) if paired else None),
    )


def _of_one(*studies: Study) -> str:
    """What an interval over a single scene, or a single seed, does not speak of."""
    if len(studies[0].scenes) == 1:
        return f"; {ONE_SCENE}"
    return f"; {ONE_SEED}" if min(study.repetitions[0] for study in studies) == 1 else ""


def _interval_cells(found: Estimate | None) -> list[Number]:
    if found is None:
        return [Number(None)] * 4
    bounds = [Number(value, "+.3f") for value in (found.mean, found.low, found.high)]
    return [*bounds, Number(found.p, ".4f")]


def orderings_table(study: Study) -> Table:
    """The orderings: does each hold, how sure is it, and what does that rest on?"""
    columns = (
        Column("claim", "Ordering"),
        SEEDS,
        Column("scenes", "Scenes"),
        *INTERVAL,
        Column("p_corrected", "p, corrected"),
        Column("paper", "Paper"),
        Column("mean", "In the mean"),
        Column("verdict", "With 95 %"),
    )
    families: dict[str, list[Ordering]] = {}
    for ordering in orderings_of(study):
        families.setdefault(ordering.family, []).append(ordering)
    body = tuple(tuple(_ordering_rows(study, members)) for members in families.values())
    caption = (
        "The orderings of the paper's F-scores, and of the selection that is ours. A difference "
        "above zero is as claimed; undecided: the interval includes zero. Each interval and p is "
        "of one claim by itself; p, corrected, is Holm's for the claims of one block"
        f"{_of_one(study)}."
    )
    return Table("orderings", caption, columns, body)


def _ordering_rows(study: Study, members: Sequence[Ordering]) -> Iterator[Row]:
    found = [difference(study, ordering.weights) for ordering in members]
    corrected = holm([None if each is None else each.p for each in found])
    for ordering, each, p in zip(members, found, corrected, strict=True):
        mean = "missing" if each is None else "holds" if each.mean > 0 else "does not hold"
        seeds = len(study.seeds(*ordering.weights, metric="fscore"))
        yield (
            ordering.claim,
            *(str(seeds), str(len(study.scenes) if seeds else 0)),
            *_interval_cells(each),
            Number(p, ".4f"),
            Number(ordering.paper, "+.3f"),
            mean,
            verdict(each),
        )


def seed_table(study: Study) -> Table:
    """The F-score of each row by seed."""
    seeds = study.seeds()
    columns = (ROW, *(Column(f"seed_{s}", f"Seed {s}") for s in seeds), Column("mean", "Mean"))
    body: list[Row] = []
    for row in study.rows:
        means = study.scores(row).mean(1).tolist()
        each = dict(zip(study.seeds(row, metric="fscore"), means, strict=True))
        cells = [Number(each.get(seed)) for seed in seeds]
        body.append((row, *cells, _over_seeds(np.array([*each.values()]))))
    return Table("seeds", "F-score by seed.", columns, (tuple(body),))


def scene_table(study: Study) -> Table:
    """The F-score of each row by test scene, over seeds."""
    columns = (ROW, *(Column(scene, scene) for scene in study.scenes))
    body: list[Row] = [
        (row, *(_over_seeds(values) for values in study.scores(row).T)) for row in study.rows
    ]
    return Table("scenes", "F-score by test scene, over seeds.", columns, (tuple(body),))


def views_table(study: Study) -> Table:
    """What the views are worth that voxels keep, by row: why a selection scores as it does."""
    columns = (
        ROW,
        Column("visible", "Truly see", "up"),
        Column("visible_of_all", "Of all views"),
        Column("spread", "Spread"),
        Column("variety", "Variety"),
        SCORE,
    )
    forms = {"visible": ".3f", "visible_of_all": ".3f", "spread": ".1f", "variety": ".1f"}
    body: list[Row] = []
    for row in study.rows:
        runs = [study.runs[row, seed] for seed in study.seeds(row)]
        if all(forms.keys() <= run.view_sets.keys() for run in runs):
            found = [
                _over_seeds(np.array([run.view_sets[key] for run in runs]), form)
                for key, form in forms.items()
            ]
            body.append((row, *found, _over_seeds(study.scores(row).mean(1))))
    caption = (
        "Of the views that fine voxels at the true surface keep: the share that truly see the "
        "voxel (and of all views whose frustum holds it), the mean angle between two of them in "
        "degrees, and how many different ones its 3x3x3 neighbourhood keeps."
    )
    return Table("views", caption, columns, _with_best([body], columns))


def runs_table(study: Study, row: str | None = None) -> Table:
    """Every score of every run and scene, or of those of one row."""
    columns = (ROW, Column("seed", "Seed"), Column("scene", "Scene"), *_metrics(study.metrics))
    body: list[Row] = [
        (name, str(seed), scene, *(Number(scores.get(p.name)) for p in study.metrics))
        for name in (study.rows if row is None else [row])
        for seed in study.seeds(name)
        for scene, scores in study.runs[name, seed].scenes.items()
    ]
    return Table("runs", "Every run and scene.", columns, (tuple(body),))


def run_table(run: Run) -> Table:
    """A run's scores by test scene, and their mean."""
    parts = metric_columns(name for scores in run.scenes.values() for name in scores)
    everywhere = [p.name for p in parts if all(p.name in s for s in run.scenes.values())]
    mean = mean_scores({name: s[name] for name in everywhere} for s in run.scenes.values())
    body: list[Row] = [
        (scene, *(Number(scores.get(p.name), p.format) for p in parts))
        for scene, scores in {**run.scenes, "mean": mean}.items()
    ]
    columns = (Column("scene", "Scene"), *_metrics(parts))
    return Table("run", "Distances in cm.", columns, (tuple(body[:-1]), (body[-1],)))
