"""What the paper's tables order, and whether a study finds the same; our selection against theirs.

Each ordering is a weighted sum of rows' F-scores that is positive in the paper, or that we claim.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tf_lab.reporting.paper import ABLATIONS, ATTENTION, DIVERSE, OURS, RANDOM, SCORES
from tf_lab.reporting.statistics import Estimate, estimate
from tf_lab.reporting.studies import Study

UNDER_OURS = "each row under ours"


@dataclass(frozen=True)
class Ordering:
    """A claim: the weighted sum of the rows' F-scores is positive."""

    family: str
    claim: str
    weights: Mapping[str, int]

    @property
    def paper(self) -> float | None:
        """The sum in the paper; None of rows that it does not have."""
        if not SCORES.keys() >= self.weights.keys():
            return None
        return sum(weight * SCORES[row]["fscore"] for row, weight in self.weights.items())


def _orderings() -> list[Ordering]:
    found = [Ordering(UNDER_OURS, f"{row} < {OURS}", {OURS: 1, row: -1}) for row in ABLATIONS]
    found += [
        Ordering("attention over random", f"K = {k}: RND < attention", {ATTENTION[k]: 1, row: -1})
        for k, row in RANDOM.items()
    ]
    for name, rows in (("attention", ATTENTION), ("RND", RANDOM)):
        found += [
            Ordering("more views are better", f"{name}: K = {a} < {b}", {rows[b]: 1, rows[a]: -1})
            for a, b in pairwise(rows)
        ]
    found += [
        Ordering(
            "attention matters more with fewer views",
            f"attention - RND: K = {b} < {a}",
            {ATTENTION[a]: 1, RANDOM[a]: -1, ATTENTION[b]: -1, RANDOM[b]: 1},
        )
        for a, b in pairwise(RANDOM)
    ]
    return found


def _our_orderings() -> list[Ordering]:
    found = [
        Ordering("diverse (ours) over both", f"K = {k}: {name} < diverse", {row: 1, rows[k]: -1})
        for name, rows in (("RND", RANDOM), ("attention", ATTENTION))
        for k, row in DIVERSE.items()
    ]
    found += [
        Ordering(
            "more views are better, diverse (ours)",
            f"diverse: K = {a} < {b}",
            {DIVERSE[b]: 1, DIVERSE[a]: -1},
        )
        for a, b in pairwise(DIVERSE)
    ]
    return found


ORDERINGS = tuple(_orderings())
OUR_ORDERINGS = tuple(_our_orderings())


def orderings_of(study: Study) -> list[Ordering]:
    """Those that a study is held against: none, if all runs are of one row."""
    papers = [ordering for ordering in ORDERINGS if all(map(study.shows, ordering.weights))]
    return papers + [ours for ours in OUR_ORDERINGS if ours.weights.keys() <= {*study.rows}]


def difference(study: Study, weights: Mapping[str, int]) -> Estimate | None:
    """The weighted sum of rows' F-scores, paired by seed and scene; None if no seed has all."""
    seeds = study.seeds(*weights, metric="fscore")
    if not seeds:
        return None
    terms = [weight * study.scores(row, seeds=seeds) for row, weight in weights.items()]
    return estimate(np.sum(terms, axis=0))


def verdict(found: Estimate | None) -> str:
    """What an estimate says of an ordering that claims it positive."""
    if found is None:
        return "missing"
    if found.low is None or found.high is None or found.low <= 0 <= found.high:
        return "undecided"
    return "holds" if found.low > 0 else "does not hold"


def summary(study: Study) -> str:
    """How many of the orderings hold, family by family."""
    lines, orderings = [], orderings_of(study)
    for family in dict.fromkeys(ordering.family for ordering in orderings):
        members = [ordering for ordering in orderings if ordering.family == family]
        found = [difference(study, ordering.weights) for ordering in members]
        known = [estimate for estimate in found if estimate is not None]
        if not known:
            lines.append(f"{family}: all {len(members)} missing")
            continue
        verdicts = [verdict(estimate) for estimate in known]
        holding = [o for o, e in zip(members, found, strict=True) if verdict(e) == "holds"]
        if len(study.scenes) == 1:
            one = " (of one scene: over seeds alone)" if holding else ""
        else:
            alone = sum(len(study.seeds(*o.weights, metric="fscore")) == 1 for o in holding)
            one = f" ({alone} of one seed: over scenes alone)" if alone else ""
        parts = [
            f"{sum(estimate.mean > 0 for estimate in known)} of {len(known)} hold in the mean",
            f"{verdicts.count('holds')} with an interval above zero{one}",
            f"{verdicts.count('does not hold')} contradicted",
        ]
        if len(known) < len(members):
            parts.append(f"{len(members) - len(known)} missing")
        lines.append(f"{family}: " + ", ".join(parts))
    return "\n".join(lines) or "the paper's orderings compare rows, and there is one only"
