"""Training of what reads depth from stereo, as a user runs it, on tiny rooms and a capture."""

import json
import shutil
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file

from helpers.killed import kill_after_first_save
from helpers.tiny_jobs import Result, call
from tf_lab.stereo.regularizer import Regularizer

JOB = (
    *("data=rooms", "data.size=1", "data.val_size=1", "data.frames=24", "data.test_frames=24"),
    *("data.width=80", "data.height=60", "data.workers=1"),
    *("frames=1", "steps=2", "validate_every=1"),
    *("trainer.accelerator=cpu", "trainer.workers=0", "output=stereo.safetensors"),
)


def pretrain(*arguments: str) -> Result:
    return call("pretrain_stereo", *JOB, *arguments)


def info(path: Path) -> dict[str, object]:
    with safe_open(path, framework="np") as file:
        return json.loads(file.metadata()["info"])


def test_weights_are_made_and_scored_on_rooms_and_on_a_capture(
    tmp_path: Path, box_scene: Path
) -> None:
    result = pretrain(f"real={box_scene}")
    assert (result.status, result.err) == (0, "")
    output = tmp_path / "stereo.safetensors"
    scores = info(output)["scores"]
    names = ("within_5cm", "within_10cm", "raw_within_5cm", "median", "confidence", "loss")
    assert set(scores) == {f"{s}/{name}" for s in ("val", "real") for name in names}  # type: ignore[call-overload]
    assert str(box_scene.parent) not in json.dumps(info(output))
    learnt = load_file(output)
    Regularizer().load_state_dict(learnt)
    assert (learnt["out.weight"] != 0).any()


@pytest.mark.long
def test_the_capture_is_scored_and_never_trained_on(tmp_path: Path, box_scene: Path) -> None:
    output = tmp_path / "stereo.safetensors"
    assert pretrain().status == 0
    without = load_file(output)
    output.unlink()
    assert pretrain(f"real={box_scene}").status == 0
    for name, value in load_file(output).items():
        assert torch.equal(value, without[name]), name


def test_a_capture_without_depth_is_told(tmp_path: Path, box_scene: Path) -> None:
    shutil.copytree(box_scene, tmp_path / "bare")
    shutil.rmtree(tmp_path / "bare" / "depth")
    result = pretrain("real=bare")
    assert result.status == 2
    assert "bare: no frame of it has depth" in result.err


@pytest.mark.long
def test_a_killed_one_goes_on_whatever_others_do(tmp_path: Path) -> None:
    kill_after_first_save("pretrain_stereo", *JOB, "steps=6")
    (last,) = Path().glob("stereo-*/last.ckpt")
    other = pretrain("steps=6", "lr=1e-4")
    assert other.status == 0 and "resuming" not in other.out
    (tmp_path / "stereo.safetensors").unlink()
    assert f"resuming {last}" in pretrain("steps=6").out
