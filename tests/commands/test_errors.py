"""Bad input: one line that names the file and the cure, exit status 2, no traceback."""

import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from hydra.errors import HydraException
from safetensors import safe_open
from safetensors.torch import save_file

from helpers.tiny_jobs import TINY, Result, call, start, told

Train = Callable[..., Result]


# --- a user's own capture ------------------------------------------------------------------------


@pytest.fixture
def mine(posed_images: Path, tmp_path: Path) -> Path:
    """A copy of the capture, to damage."""
    return Path(shutil.copytree(posed_images, tmp_path / "mine"))


def missing(mine: Path) -> None:
    shutil.rmtree(mine)


def empty(mine: Path) -> None:
    shutil.rmtree(mine)
    mine.mkdir()


def edit_poses(mine: Path, edit: Callable[[list[str]], list[str]]) -> None:
    path = mine / "poses.txt"
    path.write_text("\n".join(edit(path.read_text().splitlines())) + "\n")


def short_pose(mine: Path) -> None:
    edit_poses(mine, lambda lines: [*lines[:3], "1 0 0 0 1", *lines[4:]])


def one_pose_less(mine: Path) -> None:
    edit_poses(mine, lambda lines: lines[1:])


def lost_poses(mine: Path) -> None:
    edit_poses(mine, lambda lines: [" ".join(["nan"] * 16)] * len(lines))


def no_intrinsics(mine: Path) -> None:
    (mine / "K.txt").unlink()


def no_poses(mine: Path) -> None:
    (mine / "poses.txt").unlink()


def deeper(mine: Path) -> None:
    mine.rename("capture")
    Path("mine/scene").mkdir(parents=True)
    Path("capture").rename("mine/scene/seq-01")


def other_file(mine: Path) -> None:
    empty(mine)
    (mine / "notes.pdf").write_bytes(b"0")


def video_only(mine: Path) -> None:
    empty(mine)
    (mine / "video.mp4").write_bytes(b"0")


def bare_images(mine: Path) -> None:
    images = mine.rename("capture") / "images"
    images.rename(mine)


def numbered_images(mine: Path) -> None:
    bare_images(mine)
    for number, path in enumerate(sorted(mine.iterdir())):
        path.rename(mine / f"frame-{number:06d}.color.jpg")


def truncated_images(mine: Path) -> None:
    for path in (mine / "images").iterdir():
        content = path.read_bytes()
        path.write_bytes(content[: len(content) // 2])


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (missing, ("mine: no such folder", "give the folder")),
        (empty, ("mine: empty", "posed images go in it", "images/, poses.txt, K.txt")),
        (other_file, ("mine: of no known layout", "images/, poses.txt, K.txt")),
        (video_only, ("mine: a video, but no camera poses", "COLMAP", "docs/own_video.md")),
        (bare_images, ("mine: 24 images, but no camera poses", "COLMAP", "docs/own_video.md")),
        (
            numbered_images,
            ("mine: 24 images, but no camera poses", "frame-XXXXXX.pose.txt", "COLMAP", "docs/own"),
        ),
        (short_pose, ("poses.txt, line 4: 5 values", "write one pose a line")),
        (
            one_pose_less,
            ("poses.txt has 23 lines, images/ has 24", "write one pose an image"),
        ),
        (
            no_poses,
            ("mine: 24 images in images/, but no camera poses", "COLMAP", "poses.txt", "K.txt"),
        ),
        (deeper, ("mine: holds captures", "such as mine/scene/seq-01")),
        (lost_poses, ("mine: no usable frame", "NaN", "every frame needs")),
        (no_intrinsics, ("K.txt: missing", "3x3 intrinsics")),
        (truncated_images, ("mine: none of the", "keyframes can be read", "images/000000.jpg")),
    ],
)
def test_a_bad_capture(
    checkpoint: Path, mine: Path, damage: Callable[[Path], None], expected: tuple[str, ...]
) -> None:
    damage(mine)
    told(call("reconstruct", "input=mine", f"checkpoint={checkpoint}", "device=cpu"), *expected)
    assert not Path("outputs").exists()


def test_a_bad_capture_by_a_process(tmp_path: Path, checkpoint: Path) -> None:
    told(
        start("reconstruct", "input=nowhere", f"checkpoint={checkpoint}", cwd=tmp_path),
        "nowhere: no such folder",
    )


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("output=mesh.obj",), ("output=mesh.obj", ".ply")),
        (("format=martian",), ("format=martian", "known are")),
        (("views=0",), ("views=0", "must be at least 1")),
        (("resolution=0.03",), ("resolution=0.03", "must be a multiple")),
        (("select.policy=best",), ("select.policy=best", "choose one of attention, random")),
        (("gravity=[0,0,0]",), ("gravity",)),
        (("device=mps",), ("device=mps", "choose auto, cpu or cuda")),
        (("device=cuda:99",), ("device=cuda:99: torch sees", "use device=cpu")),
        (("online.maps_device=cuda:99",), ("online.maps_device=cuda:99", "online.maps_device=cpu")),
        pytest.param(
            ("device=cuda",),
            ("device=cuda", "use device=cpu"),
            marks=pytest.mark.skipif(torch.cuda.is_available(), reason="here it works"),
        ),
    ],
)
def test_a_bad_setting_of_reconstruct(
    checkpoint: Path, mine: Path, arguments: tuple[str, ...], expected: tuple[str, ...]
) -> None:
    if arguments[0].startswith("gravity"):
        (mine / "gravity-direction.txt").unlink()
    told(call("reconstruct", "input=mine", f"checkpoint={checkpoint}", *arguments), *expected)


# --- checkpoints ---------------------------------------------------------------------------------


def absent(path: Path) -> None:
    path.unlink()


def random_bytes(path: Path) -> None:
    path.write_bytes(bytes(range(256)) * 16)


def lightning_checkpoint(path: Path) -> None:
    torch.save({"state_dict": {}, "global_step": 5}, path)


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1000])


def rewrite(path: Path, old: str, new: str, drop: str | None = None) -> None:
    with safe_open(path, framework="pt") as file:
        metadata = {k: v.replace(old, new) for k, v in file.metadata().items()}
        state = {k: file.get_tensor(k) for k in file.keys() if k != drop}  # noqa: SIM118
    save_file(state, path, metadata)


def of_another_version(path: Path) -> None:
    rewrite(path, '"refine_blocks"', '"refinement"')


def of_another_config(path: Path) -> None:
    rewrite(path, '"hidden": 16', '"hidden": 32')


def with_a_tensor_missing(path: Path) -> None:
    with safe_open(path, framework="pt") as file:
        first = min(file.keys())
    rewrite(path, "", "", drop=first)


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (absent, ("no such checkpoint", "train one")),
        (random_bytes, ("not a checkpoint of tf_lab", "expected model.safetensors")),
        (lightning_checkpoint, ("not a checkpoint of tf_lab", "expected model.safetensors")),
        (truncated, ("not a checkpoint of tf_lab", "expected model.safetensors")),
        (of_another_version, ("another version", "refinement", "train it again")),
        (of_another_config, ("another network", " has [", "expected [", "train it again")),
        (with_a_tensor_missing, ("another network", "has no shape, expected [", "train it again")),
    ],
)
def test_a_bad_checkpoint(
    checkpoint: Path,
    posed_images: Path,
    damage: Callable[[Path], None],
    expected: tuple[str, ...],
) -> None:
    shutil.copy(checkpoint, "mine.ckpt")
    damage(Path("mine.ckpt"))
    result = call("reconstruct", f"input={posed_images}", "checkpoint=mine.ckpt")
    told(result, "mine.ckpt: ", *expected)


# --- the cache of rooms --------------------------------------------------------------------------


def garbage_scene(room: Path) -> Path:
    (room / "scene.json").write_text('{"format": 1, "na')
    return room


def truncated_distances(room: Path) -> Path:
    path = room / "groundtruth" / "sdf.npy"
    path.write_bytes(path.read_bytes()[:-1000])
    return room / "groundtruth"


def truncated_jpegs(room: Path) -> Path:
    for path in (room / "color").iterdir():
        path.write_bytes(path.read_bytes()[:300])
    return room / "color"


def truncated_mesh(room: Path) -> Path:
    path = room / "groundtruth" / "mesh_gt.ply"
    path.write_bytes(path.read_bytes()[:-1000])
    return path


@pytest.mark.parametrize(
    ("damage", "split", "workers"),
    [
        (garbage_scene, "train", 0),
        (truncated_distances, "train", 0),
        (truncated_jpegs, "train", 0),
        (truncated_jpegs, "train", 1),
        (garbage_scene, "test", 0),
        (truncated_mesh, "test", 0),
    ],
)
def test_a_corrupt_room_in_the_cache(
    outputs: Path,
    cache: Path,
    tmp_path: Path,
    damage: Callable[[Path], Path],
    split: str,
    workers: int,
) -> None:
    root = Path(shutil.copytree(cache, tmp_path / "cache"))
    (room,) = root.glob(f"rooms-*/{split}/room_*")
    named = damage(room)
    # a test room is met by an evaluation only: with the training that is there, and K of its own
    output = "outputs" if split == "train" else str(outputs)
    result = call(
        *("train", *TINY, f"data.root={root}", f"trainer.workers={workers}"),
        *(f"output={output}", f"views={7 if damage is garbage_scene else 9}"),
    )
    told(result, str(named), "again")
    assert not Path("outputs").exists()


def test_no_room_for_an_output(train: Train, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    told(train("output=file"), "file")


# --- settings ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("argument", "expected"),
    [
        ("views=0", ("views=0", "must be at least 1")),
        ("seed=-1", ("seed=-1: must be at least 0",)),
        ("data.width=0", ("data.width=0: must be at least 1",)),
        ("optimizer.steps=-3", ("optimizer.steps=-3: must be at least 0",)),
        ("training.images=0", ("training.images=0: must be at least 1",)),
        ("metrics=[normals,foo]", ("metrics=[normals,foo]: no foo among the metrics: normals",)),
        ("resolution=0.03", ("resolution=0.03", "must be a multiple")),
        ("optimizer.schedule=linear", ("optimizer.schedule=linear", "inverse_sqrt, cosine")),
        ("encoder.weights=none.pt", ("none.pt: no such weights file",)),
        ("encoder.weights=rooms", ("encoder.weights=rooms", "encoder.weights=none")),
        ("model.heads=3", ("model.width=8", "multiple of heads=3")),
        ("+model.depths=3", ("model.depths: no such setting", "--help")),
        ("+optimizer.momentum=3", ("optimizer.momentum: no such setting",)),
        ("+trainer.others.gpus=3", ("trainer", "gpus", "conf/trainer")),
        ("trainer.accelerator=abacus", ("trainer", "abacus", "conf/trainer")),
        ("trainer.accelerator=tpu", ("trainer", "torch_xla", "conf/trainer")),
        ("training.images=99", ("no chunk with 99 images", "use fewer")),
        (
            "+callbacks.swa={_target_: lightning.pytorch.callbacks.StochasticWeightAveraging, "
            "swa_lrs: 0.01}",
            ("callbacks or trainer", "SWA"),
        ),
        ("data.name=scannet", ("data.name=scannet: choose it by data=scannet",)),
    ],
)
def test_a_bad_setting_of_train(
    train: Train, tmp_path: Path, argument: str, expected: tuple[str, ...]
) -> None:
    """Told before the training, not after it."""
    told(train(f"output={tmp_path}", argument), *expected)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("command", "words", "expected"),
    [
        ("prepare", ["splits=[test,tets]"], ("splits=[tets]", "train, val, test")),
        ("reconstruct", ["data.test_size=0"], ("data=rooms: no test scene", "data.test_size")),
        (
            "evaluate",
            ["predictions=a", "groundtruth=b", "metrics=null"],
            ("metrics=null", "normals"),
        ),
        ("report", ["figures=[foo]"], ("figures=[foo]: there is no such figure", "views")),
        ("figures", ["figures=[]"], ("figures=[]", "views")),
        ("benchmark", ["views=[]"], ("views=[]", "a list of numbers")),
        ("view", ["run=nowhere", "views=4"], ("views=4", "does not use it with run=")),
        ("view", ["run=nowhere", "select=rnd"], ("select=rnd", "does not use it with run=")),
        ("figures", ["run=nowhere", "online.precision=bfloat16"], ("does not use it with run=",)),
    ],
)
def test_a_bad_setting_of_another_command(
    command: str,
    words: list[str],
    expected: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    if command == "view":
        pytest.importorskip("viser", reason="needs pip install 'tf_lab[viewer]'")
    told(call(command, *words), *expected)


def test_an_encoder_that_does_not_ship() -> None:
    result = call("train", "model=small", "encoder.weights=rooms", "data.size=1", "data.val_size=0")
    told(result, "encoder.weights=rooms", "tf_lab.pretrain model=small", "encoder.weights=FILE")


@pytest.mark.parametrize(
    ("argument", "expected"),
    [
        ("unknown=1", ("unknown: no such setting", "--help")),
        ("sede=1", ("sede: no such setting", "did you mean seed")),
        ("steps=9", ("steps: no such setting", "did you mean optimizer.steps?")),
        ("model.depths=3", ("model.depths: no such setting",)),
        ("modle=tiny", ("modle: no such setting", "did you mean model?")),
        ("fusion=foo", ("fusion=foo: no such choice", "transformer", "avg", "pred")),
        ("select=attention", ("select=attention: no such choice", "did you mean select=attn?")),
        ("fusion=average", ("did you mean fusion=avg?", "there are avg, gru, pred, transformer")),
        (
            "test_on=null",
            ("test_on=null: choose one of captures, flats, rooms, scannet, or leave",),
        ),
        ("test_on=shards", ("test_on=shards: no such choice",)),
        ("test_on.root=x", ("choose the data to test on, too, as by test_on=captures",)),
        ("model=huge", ("model=huge: no such choice", "tiny", "small", "paper")),
        ("model=", ("model=: no such choice", "tiny")),
        ("fusion=null", ("fusion=null: choose one of avg, gru, pred, transformer", "leave it out")),
        ("views", ("views: not of the form NAME=VALUE",)),
        ("seed=a=b", ("seed=a=b: cannot be read", "write 'seed=\"a=b\"'")),
        ("model.name=", ("model.name=: is empty", "leave it out")),
        ("+seed=2", ("seed", "Either remove + prefix")),
        ("--views", ("unrecognized arguments: --views", "NAME=VALUE", "--help")),
        ("views=4,8", ("views=4,8: add -m", "views=[4,8]")),
        ("sweep=inputs,views", ("sweep=inputs,views: one sweep at a time; sweep=all",)),
        ("launcher=local", ("launcher=local needs a sweep: add -m or sweep=NAME",)),
        ("views=", ("views=: must be a whole number",)),
        ("seed=many", ("seed=many: must be a whole number",)),
        ("data.size=[3]", ("data.size=[3]: must be a whole number",)),
        ("optimizer.clip=false", ("optimizer.clip=false: must be a number",)),
        ("refine=maybe", ("refine=maybe: must be true or false",)),
        ("data=captures", ("data.root is missing", "data.root=")),
    ],
)
def test_a_bad_word_on_the_command_line(argument: str, expected: tuple[str, ...]) -> None:
    told(call("train", argument), *expected)
    assert not Path("outputs").exists()


@pytest.mark.parametrize("sweeps", ["inputs,views", "[inputs,views]", "choice(inputs, views)"])
def test_two_sweeps(sweeps: str) -> None:
    told(call("train", "-m", f"sweep={sweeps}"), f"sweep={sweeps}: one sweep at a time")
    assert not Path("outputs").exists()


def test_settings_of_another_part_are_not_meant() -> None:
    line = call("train", "data=captures", "data.frames=3")
    told(line, "data.frames: no such setting", "tf_lab.train data=captures --help` lists all")
    assert "mean data.frames" not in line.err


def test_options_may_come_after_settings() -> None:
    told(call("train", "sweep=inputs,views", "-m"), "sweep=inputs,views: one sweep at a time")
    told(call("train", "launcher=local", "-m", "seed=x"), "seed=x: must be a whole number")


def test_debugging_raises_the_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TF_LAB_DEBUG", "1")
    with pytest.raises(HydraException, match="unknown"):
        call("train", "unknown=1")
    with pytest.raises(HydraException, match="views=x"):
        call("train", "views=x")


def test_an_unknown_override_by_a_process(tmp_path: Path) -> None:
    told(start("train", "unknown=1", cwd=tmp_path), "unknown: no such setting")
    assert list(tmp_path.iterdir()) == []


def test_decimating_without_its_package_is_refused_before_the_work(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "fast_simplification", None)
    result = call("reconstruct", "decimate=0.5", f"data.root={tmp_path / 'cache'}")
    told(result, "decimate= needs fast-simplification")
    assert not (tmp_path / "cache").exists()  # no room was rendered


@pytest.mark.parametrize(
    ("command", "words", "expected"),
    [
        ("prepare", ["test_on=captures"], "test_on: no such setting of tf_lab.prepare"),
        ("prepare", ["fusion=avg"], "fusion: no such setting of tf_lab.prepare"),
        ("train", ["-m", "test_on=null,rooms"], "test_on=null,rooms: choose one of"),
        (
            "train",
            ["-m", "test_on=rooms,flats", "test_on.test_size=1"],
            "test_on.test_size: settings of test_on are of one choice",
        ),
        ("train", ["test_on=rooms", "test_on.size=3"], "test_on.size=3: tf_lab.train does not use"),
    ],
)
def test_data_to_test_on_that_cannot_be(command: str, words: list[str], expected: str) -> None:
    result = call(command, *words)
    assert result.status == 2
    (line,) = result.err.splitlines()
    assert line.startswith(f"error: {expected}")
