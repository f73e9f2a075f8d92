"""Frames that paint a mesh see all of it, and are no more than that takes."""

import numpy as np
import pytest

from tf_lab.online.painting import FEW, LOOKS, painters


def test_of_few_frames_all_paint() -> None:
    assert painters(np.full((9, 4), -1), FEW).tolist() == [*range(FEW)]


@pytest.mark.parametrize("rooms", [1, 40])
def test_every_part_of_a_building_is_painted(rooms: int) -> None:
    """Rooms one after the other, each seen by frames of its own: 300 a room."""
    rng = np.random.default_rng(0)
    count = 300 * rooms
    held = np.concatenate([300 * i + rng.integers(0, 300, (500, 16)) for i in range(rooms)])
    held[rng.random(held.shape) < 0.3] = -1
    chosen = painters(held, count)
    assert (np.diff(chosen) > 0).all()
    assert chosen[0] >= 0
    assert chosen[-1] < count
    looks = np.isin(held, chosen).sum(1)
    assert (looks >= np.minimum((held >= 0).sum(1), 2)).mean() > 0.99
    assert len(chosen) < 0.6 * count  # although no two voxels hold the same ones


def test_frames_that_see_most_come_first() -> None:
    """One frame sees all, the others a voxel each: it is chosen, and of the others as needed."""
    held = np.stack([np.full(1000, 7), 100 + np.arange(1000)], 1)
    chosen = painters(held, 2000)
    assert 7 in chosen
    held = np.stack([np.full(1000, i) for i in range(LOOKS)] + [100 + np.arange(1000)], 1)
    chosen = painters(held, 2000)
    evenly = np.linspace(0, 1999, FEW).round().astype(int)
    assert set(chosen) == {*range(LOOKS), *evenly}


def test_a_surface_that_no_frame_holds() -> None:
    assert len(painters(np.full((9, 4), -1), 500)) == FEW
    assert len(painters(np.empty((0, 4), int), 500)) == FEW
