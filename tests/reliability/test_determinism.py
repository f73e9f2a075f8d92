"""What a training learns depends on its seed and its settings, not on how it was computed.

With two threads sums are taken in another order, so that weights differ by what float32 rounds;
Adam makes the first steps of weights whose gradients are all rounding as large as any other's.
"""

from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from helpers.tiny_jobs import TINY, start

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]


def learned(to: Path, *words: str, **variables: str) -> torch.Tensor:
    """All weights of a training, [n]."""
    to.mkdir()
    given = (*TINY, "optimizer.steps=10", "data.test_size=0", *words, f"output={to}")
    done = start("train", *given, cwd=to, **variables)
    assert done.status == 0, done.err
    (path,) = to.glob("trainings/*/model.safetensors")
    return torch.cat([value.flatten() for _, value in sorted(load_file(path).items())])


def test_the_same_weights(tmp_path: Path) -> None:
    first = learned(tmp_path / "first")
    assert torch.equal(learned(tmp_path / "again"), first)
    assert torch.equal(learned(tmp_path / "loaders", "trainer.workers=2"), first)
    threads = learned(tmp_path / "threads", OMP_NUM_THREADS="2")
    moved = (first - learned(tmp_path / "seed", "seed=1")).abs()
    apart = (threads - first).abs()
    print(f"2 threads: {(apart > 0).float().mean():.1%} of the weights differ, "
          f"by {apart.max():.2g} at most; another seed: {moved.max():.2g}")  # fmt: skip
    assert apart.max() < 1e-3 * moved.max()
