"""View selection against lists written out, and the reservoir against chance."""

import itertools

import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st
from scipy.stats import chi2
from torch import Tensor

from tf_lab.errors import TFLabError
from tf_lab.online.views import make_policy, selection
from tf_lab.online.views.selection import (
    AttentionSelection,
    Candidates,
    DiverseSelection,
    RandomSelection,
    angle_to_nearest,
    gumbel,
    slots,
    uniform,
)
from tf_lab.online.views.store import ViewStore

K, N = 4, 10


def lattice(n: int) -> Tensor:
    """n different voxels, also at negative coordinates."""
    edge = round(n ** (1 / 3)) + 1
    keys = torch.tensor(list(itertools.product(range(-edge // 2, edge - edge // 2), repeat=3)))
    return keys[:n]


def reservoir(keys: Tensor, seed: int, frames: int = N) -> Tensor:
    """The frames that each voxel holds after it saw 0..frames-1: [P, K], sorted."""
    policy = RandomSelection(seed)
    held = torch.full((len(keys), K), -1)
    rows = torch.arange(len(keys))
    for frame in range(frames):
        seen = torch.full((len(keys),), frame)
        shown = torch.zeros(len(keys), K + 1).long()
        chance = policy.chance(keys, seen[:, None], shown)
        slot = slots(policy, Candidates(seen, shown, chance=chance))
        kept = slot >= 0
        held[rows[kept], slot[kept]] = frame
    return held.sort(dim=1).values


def test_attention_drops_the_lowest_weight() -> None:
    weights = torch.tensor([[0.4, 0.1, 0.3, 0.2, 0.0], [0.1, 0.2, 0.3, 0.4, 9.0]])
    frames = torch.arange(5).expand(2, 5)
    for seen, expected in (([4, 17], [1, 0]), ([0, 3], [0, 3])):  # full slots, and some empty
        candidates = Candidates(torch.tensor(seen), frames, weights[..., None].log())
        assert slots(AttentionSelection(), candidates).tolist() == expected
    policy = DiverseSelection(0, attention=0)
    new_is_worst = torch.tensor([[1.0, 1, 1, 1, 0]])
    candidates = Candidates(
        torch.tensor([9]), frames[:1], torch.zeros(1, 5, 1), chance=new_is_worst
    )
    assert slots(policy, candidates).tolist() == [-1]


def test_of_equal_weights_the_first_goes() -> None:
    """Logits of few values, so that voxels hold equal views, in the store's precision."""
    rng, voxels, views = np.random.default_rng(0), 500, 8
    values = rng.integers(-2, 3, (voxels, views, 1)) * np.array([1.0, 0.5])
    e = np.exp(values)
    weights = (e / e.sum(1, keepdims=True)).mean(2)
    lowest = weights.min(1, keepdims=True)
    equal = weights < lowest * (1 + 1e-9)
    assert (equal.sum(1) > 1).mean() > 0.4
    full, frames = torch.full((voxels,), views), torch.arange(views + 1).expand(voxels, -1)
    logits = torch.from_numpy(np.concatenate([values, 9 + 0 * values[:, :1]], 1)).half()
    dropped = AttentionSelection().drop(Candidates(full, frames, logits))
    np.testing.assert_array_equal(dropped, equal.argmax(1))


@given(
    heads=st.integers(1, 3),
    views=st.integers(1, 5),
    voxels=st.integers(1, 4),
    frames=st.integers(0, 12),
    seed=st.integers(0, 2**31),
)
def test_attention_equals_a_list_of_measurements(
    heads: int, views: int, voxels: int, frames: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    store = ViewStore(views, heads, AttentionSelection(), logits=torch.float32)
    store.grow(voxels)
    keys = lattice(voxels)
    held: list[list[tuple[int, np.ndarray]]] = [[] for _ in range(voxels)]
    for frame in range(frames):
        rows = np.flatnonzero(rng.random(voxels) < 0.7)
        logits = rng.normal(size=(len(rows), heads))
        store.add(frame, torch.from_numpy(rows), keys[rows], torch.from_numpy(logits))
        for row, logit in zip(rows.tolist(), logits, strict=True):
            measurements = held[row]
            if len(measurements) == views:
                e = np.exp([m[1] for m in measurements])
                weights = (e / e.sum(0)).mean(1)
                measurements.pop(int(np.argmin(weights)))
            measurements.append((frame, logit))
    for row, measurements in enumerate(held):
        frames_held = [f for f in store.frames[row].tolist() if f >= 0]
        assert sorted(frames_held) == [m[0] for m in measurements]
        for held_frame, logit in measurements:
            slot = store.frames[row].tolist().index(held_frame)
            np.testing.assert_allclose(store.logits[row, slot], logit, rtol=1e-6)


def test_the_reservoir_is_uniform() -> None:
    """Over 10,000 voxels every frame is held K / N of the time, and every pair alike."""
    held = reservoir(lattice(10_000), seed=0)
    assert (held[:, 1:] > held[:, :-1]).all()  # K different frames each
    # Voxels are independent, so for each frame the number of voxels that hold it is binomial.
    count = torch.bincount(held.flatten(), minlength=N).numpy()
    p = K / N
    statistic = ((count - 10_000 * p) ** 2 / (10_000 * p * (1 - p))).sum() * (N - 1) / N
    assert statistic < chi2.ppf(0.999, N - 1)
    subsets = list(itertools.combinations(range(N), K))
    index = {subset: i for i, subset in enumerate(subsets)}
    count = np.bincount([index[tuple(row)] for row in held.tolist()], minlength=len(subsets))
    expected = 10_000 / len(subsets)
    assert ((count - expected) ** 2 / expected).sum() < chi2.ppf(0.999, len(subsets) - 1)


def test_neighbouring_voxels_and_neighbouring_seeds_are_independent() -> None:
    keys = lattice(8000)
    one = reservoir(keys, seed=0)
    shifted = {tuple(k): i for i, k in enumerate(keys.tolist())}
    for step in ((1, 0, 0), (0, 1, 0), (0, 0, 1)):
        pairs = [
            (i, shifted[key])
            for i, k in enumerate(keys.tolist())
            if (key := tuple(a + b for a, b in zip(k, step, strict=True))) in shifted
        ]
        a, b = torch.tensor(pairs).T
        assert shared(one[a], one[b]) == pytest.approx(K * K / N, abs=0.08)
    for seed in (1, 2, 3):
        assert shared(one, reservoir(keys, seed)) == pytest.approx(K * K / N, abs=0.08)


def shared(a: Tensor, b: Tensor) -> float:
    """Mean number of frames held by both; K^2 / N by chance."""
    return float((a[:, :, None] == b[:, None, :]).sum((1, 2)).double().mean())


@given(seed=st.integers(-(2**31), 2**31), splits=st.integers(1, 7))
def test_the_reservoir_does_not_know_the_order_of_voxels(seed: int, splits: int) -> None:
    keys = lattice(60)
    whole = reservoir(keys, seed)
    order = torch.randperm(60, generator=torch.Generator().manual_seed(splits))
    parts = torch.cat([reservoir(keys[p], seed) for p in order.chunk(splits)])
    assert torch.equal(parts, whole[order])
    assert torch.equal(whole, reservoir(keys, seed))


def test_seeds_differ_and_zero_is_one() -> None:
    held = [reservoir(lattice(200), seed) for seed in (0, 1, -1, 12345)]
    for a, b in itertools.combinations(held, 2):
        assert not torch.equal(a, b)
    assert torch.equal(reservoir(lattice(200), 0), held[0])


def test_fewer_frames_than_slots_are_all_kept() -> None:
    held = reservoir(lattice(5), 0, frames=3)
    assert held.tolist() == [[-1, 0, 1, 2]] * 5


# what Vigna's splitmix64.c gives for a seed of 1234567, one after the other
SPLITMIX64 = (6457827717110365317, 3203168211198807973, 9817491932198370423, 4593380528125082431)
ODD, WRAP = 0x9E3779B97F4A7C15, 1 << 64


def splitmix64(x: int) -> int:
    """The next number of a state, by whole numbers without end."""
    x = (x + ODD) % WRAP
    x = ((x ^ x >> 30) * 0xBF58476D1CE4E5B9) % WRAP
    x = ((x ^ x >> 27) * 0x94D049BB133111EB) % WRAP
    return x ^ x >> 31


def test_the_hash_is_splitmix64() -> None:
    states = [(1234567 + i * ODD) % WRAP for i in range(4)]
    assert tuple(map(splitmix64, states)) == SPLITMIX64
    signed = torch.from_numpy(np.array(states, np.uint64).view(np.int64))
    assert selection._mix(signed).numpy().view(np.uint64).tolist() == list(SPLITMIX64)


def test_uniform_numbers_are_52_bits_of_all_words() -> None:
    keys, counter = lattice(40), torch.arange(40) * 7
    for seed, key, count, found in zip(
        range(40), keys.tolist(), counter.tolist(), range(40), strict=True
    ):
        state = seed % WRAP
        for word in (*key, count):
            state = splitmix64(state ^ splitmix64((word + 0x632BE59B) % WRAP))
        draw = uniform(seed, keys[found : found + 1], counter[found : found + 1])
        assert draw.item() == (state >> 11) % (1 << 52) / (1 << 52)


def test_gumbel_variates_are_finite_at_both_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    ends = torch.tensor([0.0, 1 - 2**-52], dtype=torch.float64)
    monkeypatch.setattr(selection, "uniform", lambda *_: ends)
    low, high = gumbel(0, lattice(2), torch.zeros(2, 2).long()).tolist()
    assert -3 < low < -2 and 15 < high < 17  # -log(-log(1e-7)), and its mirror image


def test_uniform_numbers_lie_in_the_unit_interval() -> None:
    draw = uniform(3, lattice(20_000), torch.arange(20_000))
    assert draw.min() >= 0
    assert draw.max() < 1
    count = np.bincount((draw * 64).long().numpy(), minlength=64)
    assert ((count - 312.5) ** 2 / 312.5).sum() < chi2.ppf(0.999, 63)


def test_policies_by_name() -> None:
    assert isinstance(make_policy("attention", 0), AttentionSelection)
    policy = make_policy("random", 7)
    assert isinstance(policy, RandomSelection)
    assert policy.seed == 7
    with pytest.raises(TFLabError, match=r"select\.policy=best"):
        make_policy("best", 0)


def held_after(policy: DiverseSelection, order: list[int], views: int, logits: Tensor) -> Tensor:
    """Frames [P, K] of voxels that see frames in an order, of logits [P, N] and many directions."""
    keys = lattice(len(logits))
    centers = torch.randn(len(logits), logits.shape[1], 3, generator=torch.manual_seed(3))
    held = torch.zeros(len(logits), views + 1, dtype=torch.int64)
    for count, frame in enumerate(order):
        held[:, views] = frame
        index = held.unsqueeze(-1)
        seen = torch.full((len(logits),), count)
        candidates = Candidates(
            seen,
            held,
            torch.take_along_dim(logits.unsqueeze(-1), index, 1),
            torch.take_along_dim(centers, index, 1),
            policy.chance(keys, seen[:, None], held),
        )
        slot = slots(policy, candidates)
        held[slot >= 0, slot[slot >= 0]] = frame
    return held[:, :views].sort(1).values


def test_diverse_views_are_drawn_by_tempered_attention() -> None:
    """One view a voxel, directions left out: the Gumbel-max trick draws by softmax weights."""
    logits = torch.tensor([0.0, 1.0, -1.0, 2.0, 0.5])
    for share in (0.0, 0.3, 1.0):
        policy = DiverseSelection(2, attention=share, spread=0)
        held = held_after(policy, [*range(5)], 1, logits.expand(8000, 5))
        count = torch.bincount(held.flatten(), minlength=5).double()
        expected = 8000 * torch.softmax(share * logits, 0).double()
        assert ((count - expected) ** 2 / expected).sum() < chi2.ppf(0.999, 4)


def test_diverse_views_do_not_depend_on_when_they_came() -> None:
    logits = torch.randn(500, 9, generator=torch.Generator().manual_seed(1))
    policy = DiverseSelection(0, spread=0)
    first = held_after(policy, [*range(9)], 4, logits)
    assert torch.equal(held_after(policy, [3, 8, 1, 0, 7, 2, 6, 5, 4], 4, logits), first)
    assert len(first.unique(dim=0)) > 60  # of 126 subsets: neighbours hold other ones


def test_of_two_directions_alike_one_is_dropped() -> None:
    """As soon as directions are all that counts, whatever the new view is."""
    angles = torch.tensor([[0.0, 1.0, 1.01, 2.0], [0.5, 1.5, 2.5, 2.51]])
    centers = torch.stack([angles.cos(), angles.sin(), torch.zeros_like(angles)], -1)
    policy = DiverseSelection(0, attention=0, spread=0.5)
    candidates = Candidates(
        torch.tensor([7, 7]),
        torch.arange(4).expand(2, 4),
        torch.zeros(2, 4, 1),
        centers * torch.tensor([[[1.0]], [[3.0]]]),  # nearer or farther: the same directions
        torch.zeros(2, 4),
    )
    first, second = policy.drop(candidates).tolist()
    assert first in (1, 2)
    assert second in (2, 3)


def test_the_closer_of_close_directions_is_dropped() -> None:
    """0.1 apart, and 0.5: both logarithms are below 0."""
    angles = torch.tensor([[0.0, 0.1, 0.6]])
    centers = torch.stack([angles.cos(), angles.sin(), torch.zeros_like(angles)], -1)
    candidates = Candidates(
        torch.tensor([7]),
        torch.arange(3)[None],
        torch.zeros(1, 3, 1),
        centers,
        torch.zeros(1, 3),
    )
    assert DiverseSelection(0, attention=0, spread=1e3).drop(candidates).item() in (0, 1)


def test_angles_of_the_same_and_the_opposite_direction_are_numbers() -> None:
    """However the cosine is rounded."""
    one = torch.randn(3000, 1, 3, generator=torch.Generator().manual_seed(0))
    for other, angle in ((one * 3, 0.0), (-one / 7, np.pi)):
        found = angle_to_nearest(torch.cat([one, other], 1)) - 0.05
        torch.testing.assert_close(found, torch.full((3000, 2), angle), atol=1e-3, rtol=0)


def test_angles_to_the_nearest_other_direction() -> None:
    degrees = torch.tensor([[0.0, 10.0, 40.0, 180.0]]).deg2rad()
    centers = torch.stack([degrees.cos(), degrees.sin(), torch.zeros_like(degrees)], -1) * 2
    found = (
        angle_to_nearest(centers).rad2deg() - angle_to_nearest(centers[:, [0, 0]]).rad2deg()[0, 0]
    )
    torch.testing.assert_close(found, torch.tensor([[10.0, 10, 30, 140]]), atol=0.1, rtol=0)
    alike = angle_to_nearest(centers[:, [0, 0]])
    assert ((alike > 0) & (alike < 0.1)).all()  # radians, of which a logarithm is taken
