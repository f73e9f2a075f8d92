"""Pre-training of an encoder as a user runs it, on the tiny rooms and a made-up capture."""

import json
import shutil
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file

from helpers.killed import kill_after_first_save
from helpers.lite0 import made_up
from helpers.tiny_jobs import Result, call, tiny_config
from tf_lab.training.initial import make_network

ROOMS = (
    *("data.size=1", "data.val_size=1", "data.frames=24", "data.test_frames=24"),
    *("data.width=80", "data.height=60", "data.workers=1"),
)
JOB = (
    *ROOMS,
    *("pairs=2", "points=24", "steps=4", "validate_every=2"),
    *("trainer.accelerator=cpu", "trainer.workers=0", "output=encoder.safetensors"),
)
RESNET = (
    *("encoder.width=8", "encoder.blocks=[1,1,1]"),
    *("encoder.coarse_channels=8", "encoder.fine_channels=8"),
)
EFFICIENT = (
    *("encoder=efficientnet_lite0", "encoder.pyramid_channels=8"),
    *("encoder.coarse_channels=8", "encoder.fine_channels=8"),
)


def pretrain(*arguments: str) -> Result:
    return call("pretrain", *JOB, *arguments)


def scores(path: Path) -> dict[str, float]:
    with safe_open(path, framework="np") as file:
        return json.loads(file.metadata()["info"])["scores"]


def test_an_encoder_is_made_and_scored_on_rooms_and_on_a_capture(
    tmp_path: Path, box_scene: Path
) -> None:
    result = pretrain(*RESNET, f"real={box_scene}")
    assert (result.status, result.err) == (0, "")
    output = tmp_path / "encoder.safetensors"
    found = scores(output)
    names = ("coarse", "fine", "coarse_top1", "fine_top1", "loss")
    assert set(found) == {f"{s}/{name}" for s in ("val", "real") for name in names}
    for name in ("val/coarse_top1", "real/coarse_top1"):
        assert 0 < found[name] < 1
    with safe_open(output, framework="np") as file:
        info = file.metadata()["info"]
    assert str(box_scene.parent) not in info  # no path of this machine travels with it
    config = tiny_config("encoder.weights=" + str(output))
    network = make_network(config)  # it serves a training
    for name, value in load_file(output).items():
        assert torch.equal(network.encoder.state_dict()[name], value)


def test_no_steps_score_what_is_there_and_write_nothing(tmp_path: Path) -> None:
    """As the encoder scored when it had been made."""
    assert pretrain(*RESNET).status == 0
    made = tmp_path / "encoder.safetensors"
    files = sorted(tmp_path.rglob("*"))
    result = pretrain(*RESNET, "steps=0", f"encoder.weights={made}", "output=other/e.safetensors")
    assert (result.status, result.err) == (0, "")
    assert json.loads(result.out.splitlines()[-1].replace("'", '"')) == scores(made)
    assert sorted(tmp_path.rglob("*")) == files


def test_no_steps_score_the_shipped_encoder_by_its_name() -> None:
    result = pretrain("encoder=efficientnet_lite0", "encoder.weights=rooms", "steps=0")
    assert result.status == 0
    found = json.loads(result.out.splitlines()[-1].replace("'", '"'))
    assert found["val/coarse_top1"] > 0.4  # of 32 candidates; by chance 0.03


def test_features_are_turned_to_be_like_anothers(tmp_path: Path) -> None:
    """Of no steps, too: an encoder that is told to be like itself stays as it is."""
    assert pretrain(*RESNET).status == 0
    first = tmp_path / "encoder.safetensors"
    same = pretrain(*RESNET)
    assert "reusing the identical finished encoder.safetensors" in same.out
    turned = pretrain(*RESNET, f"like={first}")
    assert turned.status == 2 and "of other settings or data" in turned.err
    one = first.rename(tmp_path / "one.safetensors")
    assert pretrain(*RESNET, "seed=1", "output=two.safetensors").status == 0
    two = tmp_path / "two.safetensors"
    same = pretrain(*RESNET, "steps=0", f"encoder.weights={one}", f"like={one}")
    assert "cosine to the other's features: {'coarse': 1.0, 'fine': 1.0}" in same.out
    for name, value in load_file(first).items():
        torch.testing.assert_close(value, load_file(one)[name], rtol=0, atol=1e-5)
    told = pretrain(*RESNET, "steps=0", f"encoder.weights={two}", f"like={one}")
    assert told.status == 2 and "encoder.safetensors: there already, of other settings" in told.err
    first.unlink()
    none = ("seed=1", "steps=0")  # the seed draws what is scored
    assert pretrain(*RESNET, *none, f"encoder.weights={two}", f"like={one}").status == 0
    assert scores(first) == scores(two)
    changed = [k for k, v in load_file(first).items() if not torch.equal(v, load_file(two)[k])]
    assert {name.partition(".")[0] for name in changed} == {"coarse_head", "fine_head"}
    with safe_open(first, framework="np") as file:
        assert json.loads(file.metadata()["info"])["config"]["like"] == "one.safetensors"
    wide = ("encoder.width=16", "output=wide.safetensors")
    told = pretrain(*RESNET, *wide, f"like={one}")
    assert told.status == 2 and "one.safetensors: of another encoder" in told.err


def test_the_capture_is_scored_and_never_trained_on(tmp_path: Path, box_scene: Path) -> None:
    assert pretrain(*RESNET).status == 0
    without = load_file(tmp_path / "encoder.safetensors")
    assert not any(name.startswith("real/") for name in scores(tmp_path / "encoder.safetensors"))
    (tmp_path / "encoder.safetensors").unlink()
    assert pretrain(*RESNET, f"real={box_scene}").status == 0
    for name, value in load_file(tmp_path / "encoder.safetensors").items():
        assert torch.equal(value, without[name]), name


def test_a_capture_without_depth_is_told(tmp_path: Path, box_scene: Path) -> None:
    shutil.copytree(box_scene, tmp_path / "bare")
    shutil.rmtree(tmp_path / "bare" / "depth")
    result = pretrain(*RESNET, "real=bare")
    assert result.status == 2
    assert "real=bare: it has no depth" in result.err


@pytest.mark.parametrize(("factor", "moves"), [("null", False), ("0.1", True)])
def test_a_trunk_from_imagenet_stays_unless_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, factor: str, moves: bool
) -> None:
    """With made-up weights in ImageNet's place."""
    start = made_up()
    monkeypatch.setattr(
        "tf_lab.network.encoders.efficientnet.EfficientNetLite0.published_weights", lambda *_: start
    )
    assert pretrain(*EFFICIENT, f"trunk_factor={factor}").status == 0
    state = load_file(tmp_path / "encoder.safetensors")
    same = torch.equal(state["_conv_stem.weight"], start["_conv_stem.weight"])
    assert same is not moves
    for name in ("running_mean", "running_var"):
        assert torch.equal(state[f"_bn0.{name}"], start[f"_bn0.{name}"])


@pytest.mark.parametrize("effect", ["exposure", "jpeg"])
def test_the_effects_of_the_config_reach_the_training(tmp_path: Path, effect: str) -> None:
    assert pretrain(*RESNET, "steps=1", "validate_every=1").status == 0
    before = load_file(tmp_path / "encoder.safetensors")
    (tmp_path / "encoder.safetensors").unlink()
    none = {"exposure": "0", "jpeg": "100"}[effect]
    assert pretrain(*RESNET, "steps=1", "validate_every=1", f"augment.{effect}={none}").status == 0
    after = load_file(tmp_path / "encoder.safetensors")
    assert any(not torch.equal(value, before[name]) for name, value in after.items())


@pytest.mark.long
def test_a_killed_one_goes_on_whatever_others_do(tmp_path: Path) -> None:
    """The same settings resume its state; others begin beside it."""
    weights = tmp_path / "encoder.safetensors"
    kill_after_first_save("pretrain", *JOB, *RESNET)
    (last,) = Path().glob("encoder-*/last.ckpt")
    assert torch.load(last, weights_only=True)["global_step"] == 2
    other = pretrain(*RESNET, "lr=1e-4")
    assert other.status == 0 and "resuming" not in other.out
    assert last.exists()

    weights.unlink()
    assert f"resuming {last}" in pretrain(*RESNET, "trainer.workers=0").out
    resumed = load_file(weights.rename(tmp_path / "resumed.safetensors"))
    assert "resuming" not in pretrain(*RESNET).out
    for name, value in load_file(weights).items():
        torch.testing.assert_close(resumed[name], value, rtol=0, atol=1e-6)
