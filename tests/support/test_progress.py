"""Progress on a terminal and in a log."""

import time

import numpy as np
import pytest
from rich.progress import Progress

from tf_lab.support import progress


def test_a_log_gets_a_line_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also while nothing gets done, as in the minutes that a scene takes."""
    monkeypatch.setattr(progress, "FIRST", 0.05)
    monkeypatch.setattr(progress, "EVERY", 0.3)
    with progress.progress_bar() as bar:
        task = bar.add_task("rendering", total=9)
        time.sleep(0.2)
        bar.advance(task, 4)
        time.sleep(0.3)
        bar.advance(task, 5)
    counts = [line.split()[-4] for line in capsys.readouterr().out.splitlines()]
    assert (counts[0], counts[-1]) == ("0/9", "9/9")
    assert "4/9" in counts


def test_what_is_done_at_once_has_one_line_in_a_log(capsys: pytest.CaptureFixture[str]) -> None:
    with progress.progress_bar() as bar:
        for _ in bar.track(range(3), description="drawing"):
            pass
    (line,) = capsys.readouterr().out.splitlines()
    assert "3/3" in line


def test_a_terminal_gets_a_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    assert type(progress.progress_bar()) is Progress


def lefts(items: int, steps: int, seed: int) -> list[tuple[float, float]]:
    """(elapsed, estimated) of a training at default settings on two cores.

    It takes 5 s to begin, 0.3 s a step, and 15 ms for each of its 24 images that is new.
    """
    rng, pace, known = np.random.default_rng(seed), progress.Pace(), set[int]()
    now, once, found = 5.0, progress.Once(), []
    for step in range(1, steps + 1):
        drawn = set(rng.integers(items, size=24).tolist())
        new = len(drawn - known)
        known |= drawn
        now += 0.3 + 0.015 * new
        once = progress.Once(once.asked + len(drawn), len(known), once.seconds + 0.015 * new)
        left = pace.left(now, step, steps, once)
        found.append((now, left if left is not None else np.nan))
    return found


@pytest.mark.parametrize(("items", "steps"), [(4000, 2500), (100, 2500), (4000, 200), (10**6, 500)])
def test_the_time_left_is_right_within_a_factor_of_two_after_ten_seconds(
    items: int, steps: int
) -> None:
    for seed in range(3):
        found = np.array(lefts(items, steps, seed))
        true = found[-1, 0] - found[:, 0]
        late = (found[:, 0] > 10) & (true > 1)
        ratio = found[late, 1] / true[late]
        assert (late.sum() > 50, ratio.max() < 2, ratio.min() > 0.5) == (True, True, True)


def test_an_interruption_is_no_slow_step() -> None:
    pace, once = progress.Pace(), progress.Once()
    assert pace.left(1000.0, 1, 11, once) is None  # how slow was the first?
    assert pace.left(1002.0, 2, 11, once) == pytest.approx(18)
    pace.restart()
    assert pace.left(1100.0, 3, 11, once) is None
    assert pace.left(1102.0, 4, 11, once) == pytest.approx(14)


def test_the_estimate_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    with progress.progress_bar() as bar:
        task = bar.add_task("train", total=100)
        bar.update(task, completed=5, left=3725.0)
    assert "5/100" in (line := capsys.readouterr().out)
    assert " 1:02:05 left" in line
