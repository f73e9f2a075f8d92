import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from tf_lab.evaluation import PAPER
from tf_lab.evaluation.metrics import Comparison, distances, nearest, visibility
from tf_lab.evaluation.scores import mean_scores, score

EMPTY = {"acc": 100, "compl": 100, "chamfer": 100, "prec": 1, "recall": 0, "fscore": 0}


def plane(height: float, nx: int = 21, ny: int = 21, step: float = 0.05) -> np.ndarray:
    x, y = np.meshgrid(np.arange(nx) * step, np.arange(ny) * step, indexing="ij")
    return np.stack([x, y, np.full_like(x, height)], axis=-1).reshape(-1, 3)


def scored(predicted: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    return score(Comparison(predicted, np.ones(len(predicted), bool), truth))


@pytest.mark.parametrize(("shift", "match"), [(0.0, 1.0), (0.03, 1.0), (0.07, 0.0)])
def test_a_shifted_plane_is_off_by_its_shift(shift: float, match: float) -> None:
    result = scored(plane(shift), plane(0.0))
    assert tuple(result) == PAPER
    for key in ("acc", "compl", "chamfer"):
        assert result[key] == pytest.approx(100 * shift)  # centimetres
    for key in ("prec", "recall", "fscore"):
        assert result[key] == match


def test_half_a_plane_is_precise_but_recalls_half() -> None:
    truth = plane(0.0, nx=40, step=0.1)
    half = truth[truth[:, 0] < 1.95]  # 20 of 40 columns; the others are 0.1, 0.2, ... 1 m away
    result = scored(half, truth)
    compl = 100 * sum(min(0.1 * k, 1.0) for k in range(1, 21)) / 40
    assert result["acc"] == pytest.approx(0)
    assert result["compl"] == pytest.approx(compl)
    assert result["chamfer"] == pytest.approx(compl / 2)
    assert (result["prec"], result["recall"]) == (1.0, 0.5)
    assert result["fscore"] == pytest.approx(2 / 3)


def test_distances_are_capped_at_a_metre() -> None:
    found = distances(np.array([[0, 0, 0.5], [0, 0, 1.0], [0, 0, 30.0]]), np.zeros((1, 3)))
    np.testing.assert_allclose(found, [0.5, 1, 1])
    assert scored(plane(30.0), plane(0.0))["acc"] == 100


def test_the_threshold_is_inclusive() -> None:
    step = np.nextafter(0.05, 1)
    assert scored(np.array([[0, 0, 0.05]]), np.zeros((1, 3)))["prec"] == 1
    assert scored(np.array([[0, 0, step]]), np.zeros((1, 3)))["prec"] == 0


def test_an_empty_prediction_has_precision_one_and_the_worst_rest() -> None:
    assert score(None) == EMPTY


def test_neither_side_may_be_empty() -> None:
    for sides, which in (((0, 5), "prediction"), ((5, 0), "ground truth")):
        predicted, truth = (np.zeros((n, 3)) for n in sides)
        with pytest.raises(ValueError, match=which):
            scored(predicted, truth)


def test_occluded_points_leave_accuracy_and_precision_only() -> None:
    truth = np.concatenate([plane(0.0), plane(0.5)])
    predicted = np.concatenate([plane(0.0), plane(0.5), plane(0.2)])  # the last is 20 cm off
    visible = np.arange(len(predicted)) < len(plane(0.0))  # only the first is observed
    result = score(Comparison(predicted, visible, truth))
    assert result["acc"] == result["compl"] == 0  # the occluded one at 0.5 still completes
    assert result["prec"] == result["recall"] == 1


def test_all_points_count_if_none_is_visible() -> None:
    none = np.zeros(len(plane(0.0)), bool)
    assert score(Comparison(plane(0.03), none, plane(0.0)))["acc"] == pytest.approx(3)


def test_the_fscore_of_nothing_is_zero() -> None:
    assert scored(plane(0.5), plane(0.0))["fscore"] == 0


def test_the_mean_fscore_is_not_the_fscore_of_the_means() -> None:
    good, bad = dict(score(None), prec=1.0, recall=1.0, fscore=1.0), score(None)
    assert mean_scores([good, bad])["fscore"] == 0.5  # of the means: 2 * 1 * .5 / 1.5


def trilinear(volume: np.ndarray, index: np.ndarray) -> float:
    """Own loop over the eight neighbours, zero outside."""
    low = np.floor(index).astype(int)
    total = 0.0
    for corner in np.ndindex(2, 2, 2):
        voxel = low + corner
        weight = np.prod(1 - np.abs(index - voxel))
        if (voxel >= 0).all() and (voxel < volume.shape).all():
            total += weight * volume[tuple(voxel)]
    return total


def random_world2grid(rng: np.random.Generator) -> np.ndarray:
    """A rotation, another scale on every axis, and an origin that is not zero."""
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    matrix = np.eye(4)
    matrix[:3, :3] = np.diag(rng.uniform(5, 20, 3)) @ rotation
    matrix[:3, 3] = rng.uniform(-5, 5, 3)
    return matrix


@given(st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_visibility_is_trilinear_and_keeps_the_axes_apart(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = (4, 7, 11)
    mask = (rng.random(shape) < 0.1).astype(np.uint8)
    world2grid = random_world2grid(rng)
    index = rng.uniform(-1.5, np.array(shape) + 0.5, (200, 3))
    points = np.linalg.solve(world2grid[:3, :3], (index - world2grid[:3, 3]).T).T
    expected = [trilinear(1.0 - mask, i) >= 1 - 1e-5 for i in index]
    assert visibility(points, mask, world2grid).tolist() == expected


def test_visibility_at_its_bounds() -> None:
    mask = np.zeros((3, 4, 5), bool)
    mask[1, 1, 1] = True

    def visible(*index: float) -> bool:
        return bool(visibility(np.array([index]), mask, np.eye(4))[0])

    assert visible(2, 1, 1)  # a neighbour's centre: the occluded voxel has no weight
    assert not visible(1.999, 1, 1)  # 0.1 % of it
    assert visible(1.999995, 1, 1)  # less than the tolerance
    assert not visible(1, 1, 1)
    assert visible(0, 0, 0) and visible(2, 3, 4)  # the outermost centres are inside
    assert visible(2 + 1e-7, 3, 4)  # and rounding does not throw them out
    assert not visible(-0.01, 0, 0) and not visible(2, 3, 4.01)
    assert not visible(50, 50, 50)


def test_a_half_occluded_mask_counts_as_occluded() -> None:
    mask = np.full((3, 3, 3), 0.5, np.float32)
    assert not visibility(np.ones((1, 3)), mask, np.eye(4)).any()


def test_the_nearest_of_none() -> None:
    none, some = np.empty((0, 3)), plane(0.0)
    for result in nearest(none, some):
        assert result.shape == (0,)
    found, index = nearest(some, none)
    assert (found == 1.0).all() and (index == len(none)).all()  # the cap, and no such point
    found, index = nearest(plane(1.5), some)
    assert (found == 1.0).all() and (index == len(some)).all()


def test_the_f_score_is_the_harmonic_mean() -> None:
    """Of 4 predicted points 2 are near the truth, of 8 true ones 1: 2 / (1 / 0.5 + 1 / 0.125)."""
    truth = np.arange(8.0)[:, None] * [1, 0, 0]
    predicted = np.array([[0, 0, 0], [0, 0, 0.05], [0, 9, 0], [0, 0, 7]], float)  # 5 cm counts
    result = scored(predicted, truth)
    assert (result["prec"], result["recall"]) == (0.5, 0.125)
    assert result["fscore"] == pytest.approx(0.2)
    shifted = scored(truth + np.array([0, 0, 0.05]), truth)
    assert (shifted["prec"], shifted["recall"]) == (1, 1)
