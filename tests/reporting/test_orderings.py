"""The paper's orderings on studies in which we know what holds."""

from pathlib import Path

import pytest

from helpers.made_up_runs import ROWS, write_run, write_study
from tf_lab.reporting.orderings import (
    ORDERINGS,
    OUR_ORDERINGS,
    UNDER_OURS,
    difference,
    orderings_of,
    summary,
    verdict,
)
from tf_lab.reporting.paper import ATTENTION, RANDOM, SCORES
from tf_lab.reporting.statistics import Estimate
from tf_lab.reporting.studies import Study, open_study
from tf_lab.reporting.tables import comparison_table, orderings_table

PAPER = {row: SCORES[row]["fscore"] for row in ROWS}


def verdicts(study: Study) -> dict[str, str]:
    return {o.claim: verdict(difference(study, o.weights)) for o in ORDERINGS}


def test_all_hold_in_the_paper() -> None:
    assert len(ORDERINGS) == 11 + 3 + 4 + 2
    assert sum(o.family == UNDER_OURS for o in ORDERINGS) == 11
    assert all(o.paper and o.paper > 0 for o in ORDERINGS)


def test_the_sums() -> None:
    """Each family by hand, from the paper's table."""
    by_claim = {o.claim: o.paper for o in ORDERINGS}
    assert by_claim["Ours: w/o view ray < Ours"] == pytest.approx(0.655 - 0.621)
    assert by_claim["K = 8: RND < attention"] == pytest.approx(0.636 - 0.596)
    assert by_claim["RND: K = 4 < 8"] == pytest.approx(0.596 - 0.502)
    assert by_claim["attention: K = 8 < 16"] == pytest.approx(0.655 - 0.636)
    assert by_claim["attention - RND: K = 8 < 4"] == pytest.approx(0.079 - 0.040)
    assert by_claim["attention - RND: K = 16 < 8"] == pytest.approx(0.040 - 0.017)


def test_a_study_like_the_paper(tmp_path: Path) -> None:
    study, _ = open_study([write_study(tmp_path, PAPER, noise=1e-4)])
    assert set(verdicts(study).values()) == {"holds"}
    assert summary(study).splitlines()[0] == (
        "each row under ours: 11 of 11 hold in the mean, 11 with an interval above zero, "
        "0 contradicted"
    )


def test_what_rests_on_one_training_is_said(tmp_path: Path) -> None:
    study, _ = open_study([write_study(tmp_path, PAPER, seeds=[0], noise=1e-4)])
    assert summary(study).splitlines()[0] == (
        "each row under ours: 11 of 11 hold in the mean, 11 with an interval above zero "
        "(11 of one seed: over scenes alone), 0 contradicted"
    )


def test_what_rests_on_one_scene_is_said(tmp_path: Path) -> None:
    for seed in range(3):
        write_run(tmp_path, "data.test_size=1 select=rnd", seed, [0.5])
        write_run(tmp_path, "data.test_size=1", seed, [0.6 + 0.001 * seed])
    study, _ = open_study([tmp_path])
    assert summary(study).splitlines()[1] == (
        "attention over random: 1 of 1 hold in the mean, 1 with an interval above zero "
        "(of one scene: over seeds alone), 0 contradicted, 2 missing"
    )
    said = "of one scene they are of trainings alone, and say nothing of another scene"
    assert said in orderings_table(study).caption and said in comparison_table(study).caption


def test_a_study_against_the_paper(tmp_path: Path) -> None:
    mirrored = {row: 1.2 - value for row, value in PAPER.items()}
    study, _ = open_study([write_study(tmp_path, mirrored, noise=1e-4)])
    assert set(verdicts(study).values()) == {"does not hold"}


def test_a_noisy_study_decides_nothing(tmp_path: Path) -> None:
    flat = {row: 0.6 + 0.01 * value for row, value in PAPER.items()}
    study, _ = open_study([write_study(tmp_path, flat, noise=0.03)])
    assert set(verdicts(study).values()) == {"undecided"}
    # though the sums are as they were made
    for ordering in ORDERINGS:
        found = difference(study, ordering.weights)
        assert found is not None
        assert found.mean == pytest.approx(0.01 * ordering.paper, abs=1e-9)


def test_one_that_does_not_hold(tmp_path: Path) -> None:
    swapped = {**PAPER, ATTENTION[4]: PAPER[RANDOM[4]], RANDOM[4]: PAPER[ATTENTION[4]]}
    study, _ = open_study([write_study(tmp_path, swapped, noise=1e-4)])
    wrong = {claim for claim, said in verdicts(study).items() if said == "does not hold"}
    # .581 and .502 changed places: RND over attention at 4, so the gap is smaller there
    assert wrong == {"K = 4: RND < attention", "attention - RND: K = 8 < 4"}
    assert "2 of 3 hold in the mean" in summary(study)


def test_rows_that_are_missing(tmp_path: Path) -> None:
    runs = write_study(tmp_path, {"Ours": 0.6, "Ours: 4 images": 0.5}, noise=1e-4)
    study, _ = open_study([runs])
    found = verdicts(study)
    assert found.pop("Ours: 4 images < Ours") == "holds"
    assert set(found.values()) == {"missing"}
    assert "1 of 1 hold in the mean" in summary(study) and "10 missing" in summary(study)


def test_rows_of_which_none_compare(tmp_path: Path) -> None:
    """Two runs that no ordering of the paper is between: nothing is said of no ordering at all."""
    write_run(tmp_path, "views=4", 0, [0.5])
    write_run(tmp_path, "fusion=avg", 0, [0.4])
    text = summary(open_study([tmp_path])[0])
    assert "of 0" not in text
    assert "each row under ours: all 11 missing" in text.splitlines()


def test_our_selection_is_held_against_the_papers(tmp_path: Path) -> None:
    study, _ = open_study([write_study(tmp_path, PAPER, noise=1e-4)])
    assert not any(ordering in OUR_ORDERINGS for ordering in orderings_of(study))  # it was not run
    for seed in range(3):
        for k, score in ((4, 0.59), (8, 0.63), (16, 0.66)):
            write_run(tmp_path, f"views={k} select=diverse", seed, [score] * 4)
    study, _ = open_study([tmp_path])
    found = {o.claim: difference(study, o.weights) for o in orderings_of(study) if o.paper is None}
    # the paper's: attention .581, .636, .655, random .502, .596, .638
    by_hand = {
        "K = 4: RND < diverse": 0.088,
        "K = 8: RND < diverse": 0.034,
        "K = 16: RND < diverse": 0.022,
        "K = 4: attention < diverse": 0.009,
        "K = 8: attention < diverse": -0.006,
        "K = 16: attention < diverse": 0.005,
        "diverse: K = 4 < 8": 0.04,
        "diverse: K = 8 < 16": 0.03,
    }
    means = {claim: each.mean for claim, each in found.items() if each}
    assert means == pytest.approx(by_hand, abs=1e-3)
    assert "diverse (ours) over both: 5 of 6 hold in the mean" in summary(study)


def test_seeds_that_do_not_meet(tmp_path: Path) -> None:
    write_run(tmp_path, "", 0, [0.6])
    write_run(tmp_path, "views=4", 1, [0.5])
    study, _ = open_study([tmp_path])
    assert difference(study, {"Ours": 1, "Ours: 4 images": -1}) is None


def test_verdicts() -> None:
    assert verdict(Estimate(0.1, 0.05, 0.15, 0.01)) == "holds"
    assert verdict(Estimate(-0.1, -0.15, -0.05, 0.01)) == "does not hold"
    assert verdict(Estimate(0.1, -0.05, 0.25, 0.2)) == "undecided"
    assert verdict(Estimate(0.1)) == "undecided"  # one scene and one seed
    assert verdict(None) == "missing"
