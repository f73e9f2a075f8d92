"""Training on: from the weights of a checkpoint, or from the state of a training."""

import csv
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from helpers.tiny_jobs import TINY, Result, call, tiny_config, told
from tf_lab.commands.train import identified
from tf_lab.config.compose import compose_config
from tf_lab.errors import TFLabError
from tf_lab.experiments.identity import training_directory
from tf_lab.network.checkpoint import load_network, save_network, shipped_checkpoint
from tf_lab.support.headers import read_info
from tf_lab.training.initial import make_network

Train = Callable[..., Result]
NO_TEST = "data.test_size=0"
VALIDATE = ("training.validate_every=3", "training.save_every=4")  # neither divides the steps


def weights(result: Result) -> dict[str, torch.Tensor]:
    return load_file(result.path("training") / "model.safetensors")


def different(first: dict[str, torch.Tensor], second: dict[str, torch.Tensor]) -> list[str]:
    """Names of the tensors that differ by a bit."""
    assert first.keys() == second.keys()
    return [name for name in first if not torch.equal(first[name], second[name])]


def first_step(training: Path) -> int:
    """The first one logged."""
    with (training / "logs" / "version_0" / "metrics.csv").open() as file:
        return min(int(row["step"]) for row in csv.DictReader(file))


@pytest.mark.long
def test_more_steps_of_a_schedule_that_does_not_end(train: Train, tmp_path: Path) -> None:
    """The longer training is, to the bit, what it is from nothing."""
    common = (NO_TEST, "optimizer.schedule=inverse_sqrt", "optimizer.encoder_factor=1", *VALIDATE)
    short = train(*common, "optimizer.steps=7", f"output={tmp_path / 'two'}")
    long = train(*common, "optimizer.steps=20", f"output={tmp_path / 'two'}")
    assert (long.status, long.err) == (0, "")
    assert f"going on from {short.path('training') / 'last.ckpt'}" in long.out
    assert first_step(long.path("training")) >= 7
    info = read_info(long.path("training") / "model.safetensors")["training"]
    assert len(info["sessions"]) == 2
    whole = train(*common, "optimizer.steps=20", f"output={tmp_path / 'one'}")
    assert "going on" not in whole.out
    assert whole.path("training").name == long.path("training").name
    assert different(weights(long), weights(whole)) == []
    assert different(weights(short), weights(whole)) != []
    other = train(*common, "optimizer.steps=21", "seed=1", f"output={tmp_path / 'two'}")
    assert "going on" not in other.out
    fewer = train(*common, "optimizer.steps=10", f"output={tmp_path / 'two'}")  # than the long one
    assert f"going on from {short.path('training') / 'last.ckpt'}" in fewer.out
    last = torch.load(fewer.path("training") / "last.ckpt", weights_only=True)
    assert last["global_step"] == 10
    assert different(weights(fewer), weights(long)) != []


def test_more_steps_of_a_schedule_that_ended(train: Train, tmp_path: Path) -> None:
    """Is another training, and says how to have it."""
    common = (NO_TEST, f"output={tmp_path}", "optimizer.warmup=2")
    short = train(*common, "optimizer.steps=7")
    planned = train(*common, "optimizer.steps=20")
    state = short.path("training") / "last.ckpt"
    assert f"To go on from its step 7: init={state}" in planned.out
    assert first_step(planned.path("training")) < 7
    longer = train(*common, "optimizer.steps=20", f"init={state}")
    assert (longer.status, longer.err) == (0, "")
    assert first_step(longer.path("training")) >= 7
    assert longer.path("training") != planned.path("training")
    assert different(weights(longer), weights(planned)) != []
    assert different(weights(longer), weights(short)) != []
    again = train(*common, "optimizer.steps=20", f"init={state}")
    assert f"reusing the identical finished training {longer.path('training')}" in again.out


def test_on_other_devices_it_begins_anew_and_says_so(train: Train, tmp_path: Path) -> None:
    common = (NO_TEST, f"output={tmp_path}")
    first = train(*common)
    first_of = first.path("training")
    assert "note:" not in first.out
    for word in ("trainer.precision=bf16-mixed", "+trainer.others.gradient_clip_algorithm=value"):
        other = train(*common, word)
        assert other.status == 0 and "going on" not in other.out
        (note,) = (n for n in other.out.splitlines() if n.startswith(f"note: {first_of} is "))
        assert " is this training with trainer." in note
        assert note.endswith(", at step 5 of 5: with the same setting it is used")
    assert "note:" not in train(*common, "seed=1").out
    assert "note:" not in train(*common, "trainer.workers=1").out  # which is the same


def test_from_the_weights_of_a_checkpoint(train: Train, checkpoint: Path, tmp_path: Path) -> None:
    """A learning rate of 0 leaves them as they are."""
    still = ("optimizer.lr=0", "optimizer.encoder_factor=1", "optimizer.steps=2")
    result = train(NO_TEST, *still, f"init={checkpoint}", f"output={tmp_path}")
    assert (result.status, result.err) == (0, "")
    assert different(weights(result), load_file(checkpoint)) == []
    nothing = train(NO_TEST, *still, f"output={tmp_path}")
    assert nothing.path("training") != result.path("training")
    assert different(weights(nothing), weights(result)) != []


def test_images_of_another_size_than_its_own(
    train: Train, checkpoint: Path, tmp_path: Path
) -> None:
    other = ("data.width=96", "data.height=64", "optimizer.steps=1", f"init={checkpoint}")
    other += ("data.frames=6", "data.val_size=0")
    result = train(NO_TEST, *other, f"output={tmp_path}")
    assert result.status == 0
    (line,) = result.err.splitlines()
    assert line.startswith(f"warning: init={checkpoint}: was trained on images of 80x60, ")
    assert line.endswith("these are of 96x64; data.width=80 data.height=60 makes them alike")


def test_of_no_steps_the_weights_are_tested_as_they_are(
    train: Train, checkpoint: Path, tmp_path: Path
) -> None:
    """Without any data of a training."""
    none, rooms = "optimizer.steps=0", tmp_path / "rooms"
    output = f"output={tmp_path / 'tested'}"
    result = train(none, f"init={checkpoint}", output, f"data.root={rooms}")
    assert (result.status, result.err) == (0, "")
    assert different(weights(result), load_file(checkpoint)) == []
    assert (result.path("run") / "metrics.json").exists()
    origin = json.loads((result.path("training") / "run.json").read_text())
    assert origin["commit"] and "optimizer.steps=0" in origin["command"]
    assert [path.name for path in rooms.glob("*/*")] == ["test"]
    folder = train(none, f"init={checkpoint.parent}", output, f"data.root={rooms}")
    assert f"reusing the identical finished evaluation {result.path('run')}" in folder.out
    told(train(none, output), "optimizer.steps=0", "give init=")
    told(train(none, f"init={tmp_path}", output), f"{tmp_path / 'model.safetensors'}: no such")
    state = train(NO_TEST, "optimizer.steps=2", output).path("training") / "last.ckpt"
    told(train(none, f"init={state}", output), f"init={state}: is at step 2")


def test_an_encoder_takes_the_place_of_another(
    train: Train, checkpoint: Path, tmp_path: Path
) -> None:
    """The rest of the weights, and what a run is known by."""
    prefix, old = "encoder.", load_file(checkpoint)
    new = {k.removeprefix(prefix): v + 0.1 for k, v in old.items() if k.startswith(prefix)}
    save_file(new, tmp_path / "new.safetensors")
    given = (NO_TEST, "optimizer.steps=0", f"init={checkpoint}", f"output={tmp_path}")
    exchanged, before = train(*given, "init_encoder=new.safetensors"), train(*given)
    assert (exchanged.status, exchanged.err) == (0, "")
    assert exchanged.path("training") != before.path("training")
    for name, value in weights(exchanged).items():
        expected = new[name.removeprefix(prefix)] if name.startswith(prefix) else old[name]
        assert torch.equal(value, expected), name


@pytest.mark.long
def test_inputs_that_say_nothing_at_first_are_added(
    train: Train, checkpoint: Path, tmp_path: Path
) -> None:
    """A checkpoint without them is trained on with them, from what it can do."""
    given = ("inputs=stereo", f"init={checkpoint}", f"output={tmp_path}")
    before = train("optimizer.steps=0", NO_TEST, *given)
    assert (before.status, before.err) == (0, "")
    old, new = load_file(checkpoint), weights(before)
    assert all(torch.equal(new[name], old[name]) for name in old)
    added = {name.partition(".")[0] for name in new.keys() - old.keys()}
    assert added == {"agreement", "stereo_evidence"}
    assert all((new[name] == 0).all() for name in new.keys() - old.keys())
    # with nothing learnt, reconstructions are the same; a little training changes them
    scores = [train("optimizer.steps=0", *words) for words in (given, given[1:])]
    found = [json.loads((s.path("run") / "metrics.json").read_text())["mean"] for s in scores]
    assert found[0] == pytest.approx(found[1], abs=1e-4)
    after = train("optimizer.steps=3", *given)
    assert (after.status, after.err) == (0, "")
    learnt = weights(after)
    assert all((learnt[name] != 0).any() for name in learnt if name.startswith("stereo_evidence"))


@pytest.mark.usefixtures("outputs")
def test_a_checkpoint_is_known_by_its_content(checkpoint: Path, tmp_path: Path) -> None:
    network, info = load_network(checkpoint)
    copy = tmp_path / "copy.safetensors"
    save_network(network, copy, {**info, "told": "something else"})
    first, second = (training_directory(tiny_config(f"init={c}")) for c in (checkpoint, copy))
    assert first == second != training_directory(tiny_config())
    with torch.no_grad():
        next(network.parameters()).mul_(1.01)
    save_network(network, copy, info)
    assert training_directory(tiny_config(f"init={copy}")) != first
    state = checkpoint.parent / "last.ckpt"
    assert training_directory(tiny_config(f"init={state}", "optimizer.steps=9")) != (
        training_directory(tiny_config(f"init={checkpoint}", "optimizer.steps=9"))
    )


def test_encoder_weights_are_known_by_their_content(checkpoint: Path, tmp_path: Path) -> None:
    weights = tmp_path / "encoder.pth"
    keys = []
    for scale in (1.0, 1.0, 2.0):
        torch.save({"conv1.weight": torch.ones(3) * scale}, weights)
        weights = weights.rename(tmp_path / f"encoder{len(keys)}.pth")
        keys.append(training_directory(tiny_config(f"encoder.weights={weights}")))
    assert keys[0] == keys[1] != keys[2]


def test_our_encoder_is_known_by_its_content(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another version of tf_lab may ship another one under the same word."""
    shipped = tmp_path / "tiny-encoder.safetensors"
    monkeypatch.setattr("tf_lab.network.checkpoint.FOLDER", tmp_path)

    def directory(weights: object) -> Path:
        return training_directory(tiny_config("encoder=resnet_tiny", f"encoder.weights={weights}"))

    keys = []
    for scale in (1.0, 2.0):
        save_file({"conv1.weight": torch.ones(3) * scale}, shipped)
        keys.append(directory("rooms"))
    assert keys[0] != keys[1] == directory(shipped)


def test_an_encoder_out_of_a_checkpoint(tmp_path: Path) -> None:
    """By its file or, of the shipped one, by a word; known as the encoder that it is."""
    theirs = load_network(shipped_checkpoint())[0].encoder.state_dict()
    torch.save(theirs, alone := tmp_path / "alone.pth")
    directories = set()
    misfit = compose_config("train", "data.size=1", "encoder.weights=shipped")
    with pytest.raises(TFLabError, match="is of model=tiny encoder=efficientnet_lite0"):
        make_network(misfit)
    for source in ("shipped", shipped_checkpoint(), alone):
        weights = f"encoder.weights={source}"
        config = compose_config("train", "data.size=1", "encoder=efficientnet_lite0", weights)
        assert not different(theirs, make_network(config).encoder.state_dict())
        directories.add(training_directory(identified(config)))
    assert len(directories) == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["init=shipped"],
            "tiny.safetensors: of another network: width is 32 there and 8 here; give "
            "encoder=efficientnet_lite0 inputs=stereo",
        ),
        (["init=CHECKPOINT", "refine=false"], "refine is True there and False here"),
        (["init=CHECKPOINT", "encoder.fine_stride=4"], "encoder.fine_stride is 2 there and 4 here"),
        (["init=nowhere.safetensors"], "nowhere.safetensors: no such checkpoint"),
        (["init=nowhere.ckpt"], "nowhere.ckpt: no such file"),
        (["init=damaged.ckpt"], "damaged.ckpt: damaged"),
        (["init=OTHER", "optimizer.steps=9"], "no state of `python -m tf_lab.train`"),
        (["init_encoder=e.safetensors"], "takes the place of init's; without init= give enc"),
        (["init=STATE", "optimizer.steps=9", "init_encoder=CHECKPOINT"], "a state goes on as it"),
        (["init=CHECKPOINT", "init_encoder=SHIPPED"], "of another encoder: "),
        (["init=CHECKPOINT", "init_encoder=nowhere.pth"], "nowhere.pth: no such weights file"),
        (
            ["init=STATE"],
            "is at step 5 of optimizer.steps=5; give more, or model.safetensors beside it",
        ),
        (["init=STATE", "optimizer.steps=9", "refine=false"], "of another network: refine"),
        (["init=STATE", "optimizer.steps=9", "optimizer.lr=1"], "lr is 0.002 there and 1.0 here"),
    ],
)
def test_what_does_not_fit_is_named(
    checkpoint: Path, tmp_path: Path, words: list[str], message: str
) -> None:
    (tmp_path / "damaged.ckpt").write_bytes(b"damaged")
    state = torch.load(checkpoint.parent / "last.ckpt", weights_only=True)
    state["hyper_parameters"] = {"seed": 0}  # as another module of Lightning leaves them
    torch.save(state, tmp_path / "other.ckpt")
    places = {
        "OTHER": "other.ckpt",
        "CHECKPOINT": str(checkpoint),
        "SHIPPED": str(shipped_checkpoint()),
        "STATE": str(checkpoint.parent / "last.ckpt"),
    }
    for name, place in places.items():
        words = [word.replace(name, place) for word in words]
    result = call("train", *TINY, NO_TEST, *words)
    assert result.status == 2
    (line,) = result.err.splitlines()
    assert line.startswith("error: ")
    assert message in line
    assert not Path("outputs").exists()


def test_a_state_of_which_the_training_is_removed_is_not_needed(
    train: Train, tmp_path: Path
) -> None:
    """A finished training may lose its state; then more steps begin from nothing."""
    common = (NO_TEST, "optimizer.schedule=inverse_sqrt", f"output={tmp_path}")
    short = train(*common)
    (short.path("training") / "last.ckpt").unlink()
    assert "reusing the identical finished training" in train(*common).out
    longer = train(*common, "optimizer.steps=6")
    assert (longer.status, "going on" in longer.out) == (0, False)
    shutil.rmtree(longer.path("training"))


def test_a_damaged_state_of_fewer_steps_is_told(train: Train, tmp_path: Path) -> None:
    common = (NO_TEST, "optimizer.schedule=inverse_sqrt", f"output={tmp_path}")
    state = train(*common).path("training") / "last.ckpt"
    state.write_bytes(state.read_bytes()[:1000])
    longer = train(*common, "optimizer.steps=6")
    assert longer.status == 0
    assert f"note: {state} is of this training with fewer steps, but damaged" in longer.out
