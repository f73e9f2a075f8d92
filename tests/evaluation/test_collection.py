"""The torchmetrics classes agree with the pure functions."""

import numpy as np
import pytest
from torchmetrics.utilities import dim_zero_sum

from tf_lab.evaluation import METRICS, PAPER
from tf_lab.evaluation.collection import SceneMean, scene_means
from tf_lab.evaluation.contract import example
from tf_lab.evaluation.metrics import Comparison
from tf_lab.evaluation.scores import mean_scores, score
from tf_lab.evaluation.settings import NormalsSettings, PaperSettings

SCENES = [example(0.0), example(0.03), None, example(0.2)]


def test_the_mean_over_scenes_and_each_scene_on_the_way() -> None:
    means = scene_means([NormalsSettings()])
    for _ in range(2):  # again after a reset
        for found in SCENES:
            expected = score(found, [NormalsSettings()])
            assert {k: float(v) for k, v in means(found).items()} == expected
        rows = [score(found, [NormalsSettings()]) for found in SCENES]
        computed = {k: float(v) for k, v in means.compute().items()}
        assert set(computed) == {*PAPER, "normals"}
        assert computed == pytest.approx(mean_scores(rows), abs=1e-12)
        means.reset()


def test_scores_that_are_equal_by_chance_are_not_taken_for_one() -> None:
    means = scene_means()
    point = np.zeros((1, 3))
    means.update(Comparison(point, np.ones(1, bool), point))  # precision and recall are 1
    means.update(None)  # 1 and 0
    assert (float(means.compute()["prec"]), float(means.compute()["recall"])) == (1, 0.5)


def test_states_are_sums_and_the_direction_is_the_registrys() -> None:
    metric = SceneMean(PaperSettings("acc"))
    assert metric.higher_is_better is METRICS["acc"].higher_is_better is False
    assert metric.full_state_update is False
    assert metric._reductions == {"total": dim_zero_sum, "scenes": dim_zero_sum}
    metric.update(example(0.1))
    assert not metric.state_dict()  # nothing of it goes into checkpoints


def test_without_scenes_there_is_no_mean() -> None:
    with pytest.warns(UserWarning, match="before the ``update``"):
        assert np.isnan(float(SceneMean(PaperSettings("fscore")).compute()))
