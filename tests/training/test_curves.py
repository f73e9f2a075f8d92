"""The picture of a training's losses, from the log that Lightning leaves."""

import csv
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from tf_lab.errors import TFLabError
from tf_lab.training import curves
from tf_lab.training.curves import loss_curve


def write_csv(path: Path, rows: list[dict[str, object]], columns: list[str]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)


def test_loss_curve_from_a_log_with_gaps(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    rows: list[dict[str, object]] = []
    for step in range(0, 2000, 10):
        loss = 1.8 * np.exp(-step / 700) + 0.4
        noise = rng.lognormal(0, 0.15, 3)
        parts = dict(zip(("train/coarse", "train/fine"), loss * noise[:2] / 3, strict=True))
        rows.append({"step": step, "epoch": 0, "train/loss": loss * noise[2], **parts})
        if step % 400 == 390:
            rows.append({"step": step, "val/fscore": 0.7 * (1 - np.exp(-step / 900))})
    rows.append({"step": 2000, "train/loss": "nan"})
    columns = ["epoch", "step", "train/loss", "train/coarse", "train/fine", "val/fscore"]
    write_csv(tmp_path / "metrics.csv", rows, columns)
    loss_curve([tmp_path / "metrics.csv"], tmp_path / "loss.png")
    assert np.asarray(Image.open(tmp_path / "loss.png")).std() > 5


@pytest.mark.parametrize("column", ["train/loss", "val/fscore"])
def test_loss_curve_of_one_column_and_one_row(tmp_path: Path, column: str) -> None:
    write_csv(tmp_path / "metrics.csv", [{"step": 0, column: 0.5}], ["step", column])
    loss_curve([tmp_path / "metrics.csv"], tmp_path / "loss.png")
    assert (tmp_path / "loss.png").exists()


def test_loss_curve_without_anything_to_draw(tmp_path: Path) -> None:
    write_csv(tmp_path / "metrics.csv", [{"step": 0, "lr": 1}], ["step", "lr"])
    for name, message in (("metrics.csv", "none of"), ("typo.csv", "cannot be read")):
        with pytest.raises(TFLabError, match=rf"{name}: {message}"):
            loss_curve([tmp_path / name], tmp_path / "loss.png")


def test_the_bold_line_is_a_running_mean(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Over a fortieth of the curve on each side: a spike is spread over so many steps."""
    figures: list[Figure] = []
    monkeypatch.setattr(curves, "write_figure", lambda figure, path: figures.append(figure))
    losses = np.ones(200)
    losses[100] = 12.0
    rows = [{"step": i, "train/loss": loss} for i, loss in enumerate(losses)]
    write_csv(tmp_path / "metrics.csv", rows, ["step", "train/loss"])
    loss_curve([tmp_path / "metrics.csv"], tmp_path / "loss.png")
    raw, mean = (np.asarray(line.get_ydata()) for line in figures[0].axes[0].lines)
    np.testing.assert_allclose(raw, losses)
    expected = np.ones(200)
    expected[95:106] = 2.0
    np.testing.assert_allclose(mean, expected)
