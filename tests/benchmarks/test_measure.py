"""What is told of the time: with a clock and a reconstruction whose every stage takes as told."""

from typing import Any

import pytest
import torch

from tf_lab.benchmarks import measure


class Clock:
    """Seconds that pass when somebody says so."""

    now = 0.0

    def wait(self, milliseconds: float) -> None:
        self.now += milliseconds / 1000


class Stages:
    """A reconstruction and its pipeline in one: stages inside each other, as the real one's."""

    device = torch.device("cpu")

    def __init__(self, clock: Clock) -> None:
        self.clock, self.pipeline = clock, self

    def add_frame(self) -> None:
        self.clock.wait(1)
        self.see()
        self.see_fine()

    def see(self) -> None:
        self.clock.wait(1.5)
        self.see_coarse()

    def see_coarse(self) -> None:
        self.clock.wait(0.5)
        self.update_coarse()

    def update_coarse(self) -> None:
        self.clock.wait(4)

    def see_fine(self) -> None:
        self.clock.wait(3)
        self.discover()

    def discover(self) -> None:
        self.clock.wait(7)


def test_a_frame_costs_the_mean_of_the_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each stage without those inside it; finding earlier views apart from the total."""
    clock = Clock()
    work: tuple[Any, list[Any]] = Stages(clock), [(), (), ()]
    monkeypatch.setattr(measure, "at_work", lambda *_: work)
    monkeypatch.setattr(measure, "clock", lambda device: lambda: clock.now)
    nothing: Any = None
    found = measure.per_frame(nothing, nothing, eager=False, views=16)
    assert found == pytest.approx(
        {
            "feature extraction": 1,
            "coarse fusion": 2,
            "near-surface masks": 4,
            "fine fusion": 3,
            "earlier views": 7,
            "total": 10,
            "fps": 100,
        }
    )
