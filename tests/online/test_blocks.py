"""The index of blocks against a dictionary, and what lies beside what against coordinates."""

import itertools

import torch
from hypothesis import given, strategies as st
from torch import Tensor

from tf_lab.online.lattice.blocks import Blocks, dilate, pack, unpack, z_order
from tf_lab.online.lattice.table import Table

CPU = torch.device("cpu")
point = st.tuples(*[st.integers(-1000, 1000)] * 3)
batches = st.lists(st.lists(point, max_size=6), max_size=6)


def tensor(points: list[tuple[int, int, int]]) -> Tensor:
    return torch.tensor(points, dtype=torch.int64).reshape(-1, 3)


@given(st.lists(st.tuples(*[st.integers(-(1 << 20), (1 << 20) - 1)] * 3), min_size=1))
def test_keys_hold_coordinates_and_sort_like_them(points: list[tuple[int, int, int]]) -> None:
    keys = pack(tensor(points))
    assert torch.equal(unpack(keys), tensor(points))
    assert torch.equal(unpack(keys.sort().values), tensor(sorted(points)))


@given(batches)
def test_blocks_are_found_and_keep_their_numbers(
    batches: list[list[tuple[int, int, int]]],
) -> None:
    blocks = Blocks(3, CPU)
    numbers: dict[tuple[int, int, int], int] = {}
    for batch in batches:
        added = blocks.allocate(tensor(batch))
        assert added == len(set(batch) - set(numbers))
        for p in set(batch):
            number = int(blocks.find(tensor([p]))[0])
            assert numbers.setdefault(p, number) == number
        assert sorted(numbers.values()) == list(range(len(blocks)))
        for p, number in numbers.items():
            assert blocks.coords[number].tolist() == list(p)
    unknown = tensor([(1001, 0, 0), (0, -1001, 5)])
    assert blocks.find(unknown).tolist() == [-1, -1]


@given(st.lists(point, min_size=1, max_size=8), st.sampled_from([2, 3, 5]))
def test_rows_and_voxels_are_inverse(points: list[tuple[int, int, int]], edge: int) -> None:
    blocks = Blocks(edge, CPU)
    blocks.allocate(tensor(points))
    rows = blocks.rows_in(torch.arange(len(blocks)))
    assert torch.equal(rows, torch.arange(blocks.rows))
    voxels = blocks.voxels(rows)
    assert torch.equal(blocks.row_of(voxels), rows)
    assert len(torch.unique(voxels, dim=0)) == blocks.rows
    assert torch.equal(blocks.block_of(voxels), blocks.coords.repeat_interleave(edge**3, 0))


def test_neighbours() -> None:
    generator = torch.Generator().manual_seed(0)
    blocks = Blocks(3, CPU)
    blocks.allocate(torch.randint(-2, 2, (30, 3), generator=generator))
    found = blocks.neighbours(torch.arange(len(blocks)))
    assert found.shape == (len(blocks), 27, 27)
    steps = torch.tensor(list(itertools.product((-1, 0, 1), repeat=3)))
    voxels = blocks.voxels(torch.arange(blocks.rows))
    expected = blocks.row_of(voxels[:, None] + steps)
    assert torch.equal(found.flatten(0, 1), expected)
    assert (expected < 0).any()


@given(st.lists(point, min_size=1, max_size=5), st.integers(0, 2))
def test_dilation(points: list[tuple[int, int, int]], radius: int) -> None:
    steps = list(itertools.product(range(-radius, radius + 1), repeat=3))
    expected = {tuple(a + b for a, b in zip(p, s, strict=True)) for p in points for s in steps}
    found = dilate(tensor(points), radius).tolist()
    assert {tuple(p) for p in found} == expected
    if radius:
        assert len(found) == len(expected)


def test_an_empty_index() -> None:
    blocks = Blocks(3, CPU)
    assert blocks.find(tensor([(0, 0, 0)])).tolist() == [-1]
    assert blocks.row_of(tensor([(0, 0, 0)])).tolist() == [-1]
    assert blocks.allocate(tensor([])) == 0
    assert len(blocks.rows_in(torch.arange(0))) == 0


def test_a_table_grows_and_fills() -> None:
    table = Table(CPU)
    table.add_column("a", (2,), torch.float32, 7)
    table.add_column("b", (), torch.bool, 1)
    for rows in (1, 2, 5, 6, 40):
        before = table["a"].clone()
        table.grow(rows)
        assert torch.equal(table["a"][: len(before)], before)
        assert (table["a"][len(before) :] == 7).all()
        assert table["b"].all()
        table["a"][:] = torch.rand(rows, 2)
    assert table.nbytes() == 40 * 9
    assert table.nbytes("b") == 40


def test_z_order() -> None:
    coords = torch.tensor(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [3, 0, 0], [1, 1, 1], [2, 5, 0]]
    )
    assert z_order(coords).tolist() == [0, 1, 2, 4, 9, 7, 0b010001010]
    assert torch.equal(z_order(coords - 1000), z_order(coords))
    assert not len(z_order(coords[:0]))


def test_what_is_near_by_is_mostly_near_in_z_order() -> None:
    """A cube of 16^3 voxels: eighths of the order are its octants."""
    coords = torch.cartesian_prod(*[torch.arange(16)] * 3)
    parts = coords[z_order(coords).argsort()].view(8, 512, 3)
    assert ((parts.amax(1) - parts.amin(1)) == 7).all()
