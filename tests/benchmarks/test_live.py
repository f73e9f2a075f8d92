"""Live viewing, measured without a page."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from helpers.online.scenes import FAR, FRAMES, balanced, settings_of
from tf_lab.benchmarks.live import live
from tf_lab.benchmarks.report import tables
from tf_lab.data.scene import Scene


def test_what_is_measured(
    tiny_network: Callable[..., Any], box_scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tf_lab.benchmarks.live.ROUNDS", 1)
    scene = Scene(box_scene)
    network = balanced(tiny_network(far=FAR), scene)
    found = live(network, scene, list(FRAMES), settings_of(resolution=0.1))
    assert (found["frames"], found["width"], found["height"]) == (len(FRAMES), *scene.size)
    seconds = found["frames"] / found["frames a second"]
    assert 0 <= found["mean gap"] <= found["worst gap"] <= seconds - found["first after"] + 0.01
    assert found["whole after"] > 0
    assert found["bytes sent"] > 10_000
    memory = [value for name, value in found.items() if name.startswith("memory")]
    assert len(memory) == 3 and min(memory) > 2**26
    text = tables({"live": found})
    assert text.startswith("Live viewing\n6 frames, 80x60") and "worst" in text
