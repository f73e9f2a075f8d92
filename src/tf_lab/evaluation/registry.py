"""The metrics by name: how each is headed, printed, compared, and what an empty mesh scores."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from tf_lab.evaluation.settings import NormalsSettings, PaperSettings
from tf_lab.support.registry import Part, Registry


@dataclass(frozen=True, kw_only=True)
class MetricPart(Part):
    """A metric by name; the name is its key in ``metrics.json`` and in CSV files.

    Its target is a function of a `tf_lab.evaluation.metrics.Comparison`, and of its settings by
    name, that returns a number in the unit of its column; see `tf_lab.evaluation.contract`.

    Attributes:
        heading: of its column.
        format: of its numbers, as for `format`.
        higher_is_better: which way; None: nobody knows (a stored metric that is not registered).
        empty: the score of a missing or empty reconstruction.
    """

    heading: str
    format: str = ".3f"
    higher_is_better: bool | None = True
    empty: float = 0.0


METRICS: Registry[MetricPart] = Registry("metrics", "name")


def _add_paper(name: str, function: str, heading: str, **others: Any) -> str:
    target = f"tf_lab.evaluation.metrics:{function}"
    METRICS.add(MetricPart(name, target, PaperSettings, heading=heading, **others))
    return name


_CENTIMETRES: dict[str, Any] = {"format": ".2f", "higher_is_better": False, "empty": 100.0}
# the paper's, in the order of its tables; every run is scored by them
PAPER = (
    _add_paper("acc", "accuracy", "Acc", **_CENTIMETRES),
    _add_paper("compl", "completeness", "Compl", **_CENTIMETRES),
    _add_paper("chamfer", "chamfer", "Chamfer", **_CENTIMETRES),
    _add_paper("prec", "precision", "Prec", empty=1.0),
    _add_paper("recall", "recall", "Recall"),
    _add_paper("fscore", "fscore", "F-score"),
)

METRICS.add(
    MetricPart(
        "normals",
        "tf_lab.evaluation.normals:normal_consistency",
        NormalsSettings,
        heading="Normals",
    )
)


def with_paper(more: Sequence[Any] = ()) -> list[Any]:
    """The settings of all metrics of a run: the paper's, and after them ``more`` settings."""
    others = [settings for settings in more if METRICS.named(settings).name not in PAPER]
    return [*map(PaperSettings, PAPER), *others]


def metric_columns(names: Iterable[str] = ()) -> list[MetricPart]:
    """The columns of a table in which metrics of these names occur: the paper's always, first.

    A name may be followed by settings, in brackets. Of a metric that is registered no more, only
    the name is known.
    """
    return [_column(name) for name in dict.fromkeys([*PAPER, *names])]


def _column(name: str) -> MetricPart:
    plain, space, settings = name.partition(" ")
    if plain not in METRICS:
        return MetricPart(name, "", object, heading=name, higher_is_better=None)
    part = METRICS[plain]
    return replace(part, name=name, heading=f"{part.heading} {settings}") if space else part
