"""Paths and names are taken from the command line as they stand, whatever they look like."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from hypothesis import given, settings, strategies as st
from omegaconf import OmegaConf

from tf_lab.config.compose import compose_config
from tf_lab.config.schema import CONFIGS, ReconstructConfig, ReportConfig, TrainConfig
from tf_lab.config.text_settings import Texts, quote_overrides
from tf_lab.config.typed import typed
from tf_lab.errors import TFLabError

ODD = (
    *("20240101", "2024_01_01", "1234e56", "-5", "0x1f", "nan", "true", "No", "NULL", "1:2"),
    *("Küche (1)", "a=b", "x#1", "Müller, Hans", "two  blanks", " blank ", "[1]", "{a,b}"),
    *("${seed}", "\\${seed}", "it's", 'a "b"', "back\\slash", "back\\", "%d*?", "日本"),
)


def composed(command: str, *words: str, sweeps: bool = False) -> Any:
    """What a command gets for these words of its command line."""
    texts = Texts.of(CONFIGS[command])
    return compose_config(command, *quote_overrides(words, texts, sweeps).values())


def of(config: Any, name: str) -> Any:
    for part in name.split("."):
        config = getattr(config, part)
    return config


@pytest.mark.parametrize("text", ODD)
def test_as_it_stands(text: str) -> None:
    assert composed("reconstruct", f"input={text}").input == text
    assert compose_config("reconstruct", f"input={text}").input == text  # as from Python


@pytest.mark.parametrize(  # commas between words separate jobs
    "text", [*filter(lambda text: ", " not in text, ODD), "My Data/ScanNet v2", "C:/scans"]
)
def test_a_job_of_a_sweep_gets_it_as_it_stands(text: str) -> None:
    """The sweeper writes the settings of a job anew, which the job's process reads."""
    given = quote_overrides([f"data.root={text}"], Texts.of(TrainConfig), sweeps=True).values()
    (override,) = OverridesParser.create().parse_overrides([*given])
    job = f"{override.get_key_element()}={override.get_value_element_as_str()}"
    assert composed("train", "data=scannet", job).data.root == text


@pytest.mark.parametrize(
    ("command", "name", "others"),
    [
        ("reconstruct", "checkpoint", ()),
        ("reconstruct", "output", ()),
        ("reconstruct", "format", ()),
        ("evaluate", "predictions", ("groundtruth=a",)),
        ("evaluate", "groundtruth", ("predictions=a",)),
        ("evaluate", "output", ("predictions=a", "groundtruth=a")),
        ("report", "runs", ()),
        ("report", "study", ()),
        ("benchmark", "output", ()),
        ("train", "data.furniture", ()),
        ("train", "data.textures", ()),
        ("pretrain_stereo", "output", ()),
        ("pretrain_stereo", "real", ()),
        ("pretrain", "output", ()),
        ("pretrain", "data.root", ()),
        ("pretrain", "real", ()),
        ("train", "init", ()),
        ("train", "groundtruth", ()),
        ("train", "init_encoder", ("init=shipped",)),
        ("pretrain", "like", ()),
        ("prepare", "shards", ()),
        ("prepare", "data.root", ("data=captures",)),
        ("prepare", "data.scenes", ("data=captures", "data.root=a")),
        ("prepare", "data.format", ("data=captures", "data.root=a")),
        ("train", "output", ()),
        ("train", "data.root", ("data=scannet",)),
        ("train", "data.urls", ()),
        ("train", "data.val", ("data=captures", "data.root=a")),
        ("train", "encoder.weights", ()),
        ("train", "model.name", ()),
        ("train", "logger.project", ("logger=wandb",)),
    ],
)
def test_everywhere(command: str, name: str, others: tuple[str, ...]) -> None:
    several = name in Texts.of(CONFIGS[command]).lists
    for text in ("2024_01_01", "Müller (1) a=b #$x" if several else "Müller, (1) a=b #$x"):
        assert of(composed(command, *others, f"{name}={text}"), name) == text


@settings(max_examples=25)
@given(st.text(st.sampled_from("\\'\"${}[](),=~#: \taä0_."), min_size=1, max_size=9))
def test_any_text(text: str) -> None:
    """Also where another setting is made of it."""
    if not text.strip() or text.startswith("~") or (text[0] in "'\"" and text[-1] == text[0]):
        return  # empty, expanded, or quoted for Hydra
    data = composed("prepare", "data=captures", f"data.root={text}").data
    assert (data.root, data.scenes) == (text, f"{text}/tf_lab")


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ("[2024_05_01,kitchen]", ["2024_05_01", "kitchen"]),
        ("[ true , 'a, b',\"c\"]", ["true", "a, b", "c"]),
        ("[Küche (1),x=y,null]", ["Küche (1)", "x=y", "null"]),
        ("[a[0-3],{b,c}/d]", ["a[0-3]", "{b,c}/d"]),
        ("[]", []),
        ("scenes.txt", "scenes.txt"),
    ],
)
def test_lists_are_of_texts(value: str, expected: list[str] | str) -> None:
    words = ("data=captures", "data.root=a", f"data.test={value}")
    found = composed("train", *words).data.test
    assert (found if isinstance(found, str) else list(found)) == expected


def test_null_and_quotes_and_interpolations_can_still_be_said() -> None:
    assert composed("reconstruct", "input=null").input is None
    assert composed("reconstruct", "input='a b'").input == "a b"
    assert composed("reconstruct", 'input="x${seed}"').input == "x0"


def test_the_home_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/${me}")
    monkeypatch.setenv("TF_LAB_CACHE", "~/cache")
    home = "/home/${me}"
    config = composed("reconstruct", "input=~/a, b", 'checkpoint="~/x"', "output=a/~b.ply")
    assert (config.input, config.checkpoint) == (f"{home}/a, b", f"{home}/x")
    assert config.output == "a/~b.ply"
    assert config.data.root == f"{home}/cache"
    assert composed("report", "runs=[~/a,b]").runs == [f"{home}/a", "b"]


@pytest.mark.parametrize("word", ["input=", "data.root= ", "+output="])
def test_an_empty_text_is_told(word: str) -> None:
    """As an unset variable of the shell makes it."""
    with pytest.raises(TFLabError, match="is empty"):
        quote_overrides(
            [word], Texts.of(TrainConfig if "data" in word else ReconstructConfig), False
        )


def test_in_a_sweep_commas_separate(tmp_path: Path) -> None:
    def swept(word: str) -> str:
        return quote_overrides([word], Texts.of(TrainConfig), sweeps=True)[word]

    assert swept("data.root=2024_01_01, b c") == "data.root='2024_01_01','b c'"
    assert swept("data.test=[a,1],[b]") == "data.test=[a,'1'],[b]"
    assert swept("encoder.weights=choice(none,rooms)") == "encoder.weights=choice(none,rooms)"
    assert swept("data.root='a,b'") == "data.root='a,b'"
    assert swept("output=a,b") == "output='a,b'"  # a sweep has one
    (tmp_path / "a,b").mkdir()
    assert swept(f"data.root={tmp_path}/a,b") == f"data.root='{tmp_path}/a,b'"


def test_a_list_from_a_file_is_told() -> None:
    values = OmegaConf.create({"runs": ["a", 2024]})
    with pytest.raises(TFLabError, match=r"runs=2024: must be text"):
        typed(ReportConfig, values)


def test_texts_are_what_the_schema_says() -> None:
    texts = Texts.of(TrainConfig)
    assert {"output", "init", "data.root", "data.test", "encoder.weights", "model.name"} <= (
        texts.names
    )
    assert not {"views", "seed", "refine", "data.width", "training.views"} & texts.names
    assert {"data.urls", "data.test"} <= texts.lists
    assert "output" not in texts.lists


def test_from_a_shell(tmp_path: Path) -> None:
    """A process, started by a line as people type it."""
    folder = tmp_path / "Küche, (1) #a=b"
    (folder / "2024_01_01").mkdir(parents=True)
    line = f"'{sys.executable}' -m tf_lab.evaluate predictions=2024_01_01 groundtruth=\"$PWD\"/true"
    done = subprocess.run(["bash", "-c", line], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr == f"error: {folder}/true: no such folder; give the folder of all " + (
        "ground truths\n"
    )
