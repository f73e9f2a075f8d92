"""Every shipped config composes, `model=paper` says what the paper says, and all are found."""

import subprocess
import sys
import zipfile
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
import torch
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf, open_dict

from tf_lab.config.build import build_network, capture_settings
from tf_lab.config.compose import compose_config, conf_dir
from tf_lab.config.groups import InputSettings
from tf_lab.config.registration import register
from tf_lab.config.schema import CONFIGS as SCHEMAS, PARTS
from tf_lab.config.typed import typed
from tf_lab.errors import TFLabError
from tf_lab.online.settings import ReconstructionSettings
from tf_lab.training.schedule import learning_rate_factor

CONF = conf_dir()
REPOSITORY = Path(__file__).resolve().parents[2]
OPTIONS = sorted(
    {f"{path.parent.name}={path.stem}" for path in CONF.glob("*/*.yaml") if path.parent != CONF}
    | {f"{parts.group}={part.choice}" for parts in PARTS for part in parts}
)
COMMANDS = sorted(path.stem for path in CONF.glob("*.yaml"))


def composed(name: str = "train", *overrides: str) -> Any:
    """A config, as the command's function gets it."""
    return compose_config(name, *overrides)


def with_hydra(*overrides: str) -> list[Any]:
    """What the train command gets, and how Hydra is to run it."""
    register()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        config = compose("train", overrides=list(overrides), return_hydra_config=True)
    how = OmegaConf.masked_copy(config.hydra, ["mode", "launcher", "sweeper"])
    with open_dict(config):
        del config["hydra"]
    return [typed(SCHEMAS["train"], config), OmegaConf.to_container(how)]


# what the user has to say beside an option
NEEDED = {"data=captures": ["data.root=captures"]}


@pytest.mark.usefixtures("any_launcher")
@pytest.mark.parametrize("option", OPTIONS)
def test_every_option_composes_and_is_accepted(option: str) -> None:
    config = composed("train", option, *NEEDED.get(option, []))
    assert config.training.chunk.images == config.training.images
    assert capture_settings(config).select == config.select
    assert isinstance(config.seed, int)


@pytest.mark.usefixtures("any_launcher")
def test_ray_is_told_what_a_job_needs() -> None:
    register()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        words = ["launcher=ray", "launcher.cpus=4"]
        hydra = compose("train", words, return_hydra_config=True).hydra
    launcher = OmegaConf.to_container(hydra.launcher, resolve=True)
    init = {"address": None, "object_store_memory": None}  # a number is refused by a cluster
    assert launcher["ray"] == {"init": init, "remote": {"num_gpus": 1, "num_cpus": 4}}


# the options that README and sweeps rely on; the first of a group is its default
CONTRACT = {
    "fusion": ["transformer", "avg", "pred", "gru"],
    "inputs": ["all", "no_depth", "no_ray", "matching"],
    "select": ["attn", "rnd", "diverse"],
    "model": ["tiny", "small", "paper"],
    "encoder": ["resnet_tiny", "resnet_small", "resnet18", "efficientnet_lite0"],
    "data": ["rooms", "flats", "scannet", "captures"],
    "trainer": ["auto", "gpu", "ddp"],
    "optimizer": ["tiny", "small", "paper"],
    "training": ["tiny", "small", "paper"],
    "callbacks": ["none", "learning_rate"],
    "logger": ["csv", "tensorboard", "wandb", "wandb_offline"],
    "launcher": ["local", "slurm", "ray"],
    "metrics": ["", "normals"],
    "sweep": ["", "main_ablation", "inputs", "views", "all", "study"],
    "row": [
        *("ours", "avg", "pred", "no_refine", "no_filter", "no_depth", "no_ray", "matching"),
        *("views4", "views4_rnd", "views8", "views8_rnd", "views16_rnd"),
        *("views4_diverse", "views8_diverse", "views16_diverse"),
    ],
}


@pytest.mark.usefixtures("any_launcher")
@pytest.mark.parametrize("group", CONTRACT)
def test_every_option_of_the_contract_says_something_of_its_own(group: str) -> None:
    """It is there, the first is what happens without a word, and no two are the same."""
    found: list[Any] = []
    for option in CONTRACT[group]:
        word = f"{group}={option}"
        words = [word, *NEEDED.get(word, [])] if option else []
        found.append(with_hydra(*words))
        assert found.count(found[-1]) == 1, option
    assert found[0] == with_hydra()


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_composes(name: str) -> None:
    needed = {"evaluate": ["predictions=a", "groundtruth=b"], "check": ["input=a"]}
    given = needed.get(name, [])
    assert isinstance(composed(name, *given), SCHEMAS[name])


def test_an_ablation_changes_one_thing() -> None:
    ours = asdict(composed())
    for option, path, value in (
        ("fusion=avg", ("fusion", "strategy"), "avg"),
        ("fusion=pred", ("fusion", "strategy"), "pred"),
        ("inputs=no_depth", ("inputs", "depth"), False),
        ("inputs=no_ray", ("inputs", "ray"), False),
        ("inputs=matching", ("inputs", "matching"), True),
        ("refine=false", ("refine",), False),
        ("filter=false", ("filter",), False),
        ("select=rnd", ("select", "policy"), "random"),
        ("views=4", ("views",), 4),
    ):
        changed = asdict(composed("train", option))
        part = changed
        for key in path[:-1]:
            part = part[key]
        assert part[path[-1]] == value
        # with that one value put back, nothing else differs
        original: Any = ours
        for key in path:
            original = original[key]
        part[path[-1]] = original
        assert changed == ours, option


def test_paper_is_the_paper() -> None:
    """Sec. 3.1, 3.4 and 3.5: each number as it is printed there."""
    config = composed("train", "model=paper")
    model, encoder = config.model, config.encoder
    assert (model.width, model.blocks, model.heads) == (256, 8, 4)
    assert (config.fusion.strategy, config.refine, config.filter) == (
        *("transformer", True),
        True,
    )
    assert config.inputs == InputSettings(depth=True, ray=True, matching=False)
    # ResNet-18 (He et al. 2016, table 1), pre-trained on ImageNet
    assert encoder.name == "resnet"
    assert (encoder.blocks, encoder.width, encoder.norm) == ([2, 2, 2, 2], 64, "batch")
    assert (encoder.stem_stride, encoder.stem_pool) == (2, True)
    assert encoder.weights == "imagenet"
    assert encoder.unit_norm is False
    optimizer = config.optimizer
    assert (optimizer.lr, optimizer.betas, optimizer.eps) == (1e-4, (0.9, 0.999), 1e-8)
    assert (optimizer.weight_decay, optimizer.warmup) == (1e-4, 5000)
    assert (optimizer.schedule, optimizer.clip) == ("inverse_sqrt", 0)
    training = config.training
    assert (training.chunks, training.images, training.views) == (4, 8, ())
    assert config.optimizer.encoder_factor == 1
    assert (training.points, training.near_share) == (1000, 0.8)
    assert training.sdf_weight == 0
    assert (config.views, config.resolution, config.threshold) == (16, 0.02, 0.5)
    assert config.keyframe_distance == 0.1


@pytest.mark.parametrize("model", ["tiny", "small"])
@pytest.mark.parametrize("encoder", [None, "efficientnet_lite0"])
def test_a_model_takes_any_encoder(model: str, encoder: str | None) -> None:
    """Its maps are the model's; what makes them is the encoder's."""
    words = [] if encoder is None else [f"encoder={encoder}"]
    config = composed("train", f"model={model}", *words, "encoder.weights=none")
    assert config.encoder.name == (encoder or "resnet")
    network = build_network(config)
    maps = network.encode(torch.zeros(1, 3, 32, 48))
    for level, stride in (("coarse", 8), ("fine", 2)):
        channels = getattr(config.encoder, f"{level}_channels")
        assert maps[level].shape == (1, channels, 32 // stride, 48 // stride)
    assert hasattr(config.encoder, "width") == (encoder is None)  # nothing of the other's is left


def test_the_papers_schedule() -> None:
    """Linear to 1e-4 over 5k steps, then with the inverse square root of the step."""
    settings = composed("train", "model=paper").optimizer
    assert learning_rate_factor(settings, 2499) == pytest.approx(0.5)
    assert learning_rate_factor(settings, 4999) == pytest.approx(1)
    assert learning_rate_factor(settings, 19_999) == pytest.approx(0.5)
    assert learning_rate_factor(settings, 124_999) == pytest.approx(0.2)


def test_the_cosine_schedule_ends_at_zero() -> None:
    settings = composed("train", "optimizer.steps=1000", "optimizer.warmup=50").optimizer
    assert settings.schedule == "cosine"
    assert learning_rate_factor(settings, 24) == pytest.approx(0.5)
    assert learning_rate_factor(settings, 525) == pytest.approx(0.5, abs=1e-6)
    assert learning_rate_factor(settings, 1000) == pytest.approx(0, abs=1e-6)


def test_the_schedule_that_is_level_until_its_last_fifth() -> None:
    """So that the first steps of a longer training are the same."""
    words = ("optimizer.schedule=warmup_stable_decay", "optimizer.warmup=50")
    short, long = (
        composed("train", *words, f"optimizer.steps={n}").optimizer for n in (1000, 3000)
    )
    assert learning_rate_factor(short, 24) == pytest.approx(0.5)
    for step in (*range(0, 800, 50), 799):
        assert learning_rate_factor(short, step) == learning_rate_factor(long, step)
    assert learning_rate_factor(short, 799) == 1
    assert learning_rate_factor(short, 900) == pytest.approx(0.5)
    assert learning_rate_factor(short, 1000) == 0


def test_configs_are_found_from_any_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = composed()
    monkeypatch.chdir(tmp_path)
    assert composed() == here
    assert conf_dir().is_absolute()


@pytest.mark.slow
def test_the_wheel_has_configs_and_weights(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "pip", "wheel", "--no-deps", "-q", "-w", str(tmp_path), "."]
    subprocess.run(build, cwd=REPOSITORY, check=True, timeout=300)
    (wheel,) = tmp_path.glob("tf_lab-*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    expected = [f"tf_lab/conf/{p.relative_to(CONF)}" for p in CONF.rglob("*.yaml")]
    expected += [f"tf_lab/conf/sweep/{p.name}" for p in (CONF / "sweep").glob("*.yaml")]
    expected += ["tf_lab/conf/sweep/all.yaml", "tf_lab/conf/sweep/wandb/main_ablation.yaml"]
    weights = REPOSITORY / "src" / "tf_lab" / "weights"
    expected += [f"tf_lab/weights/{p.name}" for p in weights.glob("*") if p.is_file()]
    assert [name for name in expected if name not in names] == []


def test_how_reconstructions_compute_is_said_once_for_all_commands() -> None:
    options = {"precision": "bfloat16", "maps_device": "cpu", "maps_budget": 0.5, "batch": 7}
    overrides = [f"online.{name}={value}" for name, value in options.items()]
    for command in ("train", "reconstruct"):
        found = capture_settings(composed(command, *overrides))
        assert (found.precision, found.maps, found.maps_device) == ("bfloat16", "bfloat16", "cpu")
        assert (found.maps_budget, found.batch) == (2**29, 7)
        default = capture_settings(composed(command))
        assert default == ReconstructionSettings(views=16)
    assert composed("benchmark").online == replace(composed().online, precision="auto")


@pytest.mark.parametrize(
    "wrong", ["precision=int8", "maps_device=tpu3", "maps_budget=0", "maps_budget=-1", "batch=0"]
)
def test_what_cannot_be_computed_with_is_told(wrong: str) -> None:
    with pytest.raises(TFLabError, match=wrong.removeprefix("maps_d").split("=")[0]):
        capture_settings(composed("train", f"online.{wrong}"))


def test_the_optimizer_is_the_models_or_another() -> None:
    tiny = compose_config("train", "model=tiny")
    assert (tiny.optimizer.steps, tiny.training.images) == (2500, 12)
    mixed = compose_config("train", "model=tiny", "optimizer=paper", "training=small")
    assert (mixed.model.name, mixed.optimizer.steps, mixed.training.images) == ("tiny", 200000, 16)
    assert mixed.optimizer == compose_config("train", "model=paper").optimizer
