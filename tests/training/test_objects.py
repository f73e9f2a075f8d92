"""Objects by the name of their class: which may be made, and what is said of the others."""

from importlib.metadata import EntryPoint

import pytest
from lightning.pytorch.callbacks import Callback, LearningRateMonitor
from lightning.pytorch.loggers import Logger

from tf_lab.config.compose import compose_config
from tf_lab.errors import TFLabError
from tf_lab.training.objects import instantiated, make, make_callbacks

MONITOR = "lightning.pytorch.callbacks.LearningRateMonitor"


def test_a_callback_with_its_arguments() -> None:
    node = {"_target_": MONITOR, "logging_interval": "step"}
    made = make(Callback, "callbacks.rate", node)
    assert isinstance(made, LearningRateMonitor)
    assert made.logging_interval == "step"
    (chosen,) = make_callbacks(compose_config("train", "callbacks=learning_rate"))
    assert isinstance(chosen, LearningRateMonitor)
    given = compose_config("train", f"+callbacks.mine._target_={MONITOR}")
    assert len(make_callbacks(given)) == 1
    assert make_callbacks(compose_config("train")) == []


@pytest.mark.parametrize(
    ("target", "expected"),
    [
        ("os.system", r"^logger\._target_=os\.system: only classes of lightning, "),
        ("subprocess.Popen", "only classes of"),
        ("lightningx.Logger", "only classes of"),
        (None, "only classes of"),
        ("torch.hub.load", "is no class"),
        ("torch.NoSuchThing", "cannot be imported"),
        ("tf_lab.no_such_module.Thing", "cannot be imported"),
        (MONITOR, "is no Logger"),
    ],
)
def test_what_may_not_be_made(target: str | None, expected: str) -> None:
    with pytest.raises(TFLabError, match=expected) as error:
        make(Logger, "logger", {"_target_": target, "command": "true"})
    assert "\n" not in str(error.value)


def test_nothing_else_is_hidden_in_an_argument() -> None:
    hidden = {"a": [{"b": {"_target_": "os.system", "command": "true"}}]}
    with pytest.raises(TFLabError, match=r"^trainer\.others\.a\.0\.b\._target_=os\.system"):
        instantiated("trainer.others", hidden)
    with pytest.raises(TFLabError, match=r"^callbacks\.x\.more\._target_=os\.system"):
        make(Callback, "callbacks.x", {"_target_": MONITOR, "more": {"_target_": "os.system"}})


def test_wrong_arguments_are_told_in_one_line() -> None:
    with pytest.raises(TFLabError, match=r"callbacks\.x: .*LearningRateMonitor.*colour"):
        make(Callback, "callbacks.x", {"_target_": MONITOR, "colour": "red"})


def test_arguments_of_the_trainer_may_be_objects() -> None:
    node = {"_target_": "lightning.pytorch.strategies.SingleDeviceStrategy", "device": "cpu"}
    found = instantiated("trainer.others", {"strategy": node, "limit": 3})
    assert type(found["strategy"]).__name__ == "SingleDeviceStrategy"
    assert found["limit"] == 3


def test_packages_with_parts_of_their_own_may_be_named(monkeypatch: pytest.MonkeyPatch) -> None:
    node = {"_target_": "collections.Counter"}
    with pytest.raises(TFLabError, match="only classes of"):
        make(dict, "callbacks.x", node)
    point = EntryPoint("parts", "collections.abc", "tf_lab.parts")
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: [point])
    assert make(dict, "callbacks.x", node) == {}
