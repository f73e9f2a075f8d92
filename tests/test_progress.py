"""Progress on a terminal and in a log."""

import pytest
from rich.progress import Progress

from tf_lab import progress


def test_a_log_gets_a_line_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = 1000.0
    monkeypatch.setattr(progress.time, "monotonic", lambda: now)
    with progress.progress_bar() as bar:
        task = bar.add_task("train", total=100)
        for step in range(1, 101):
            now += 2
            bar.update(task, completed=step, description=f"train loss {1 / step:.2f}")
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(" ")[2] for line in lines] == ["0.03", "0.02", "0.01", "0.01"]
    assert [line.split()[4] for line in lines] == ["30/100", "60/100", "90/100", "100/100"]


def test_a_terminal_gets_a_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    assert type(progress.progress_bar()) is Progress
