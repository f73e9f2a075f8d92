"""From configs to objects."""

from dataclasses import replace

import pytest

from tf_lab.config.build import check_test
from tf_lab.config.compose import compose_config
from tf_lab.errors import TFLabError
from tf_lab.online.views import POLICIES


def test_what_a_test_is_made_with_is_tried_before_the_training(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    config = compose_config("train", "select=rnd")
    check_test(config)
    gone = replace(POLICIES["random"], target="tf_lab.online.views.selection:Gone")
    monkeypatch.setitem(POLICIES._parts, "random", gone)
    with pytest.raises(TFLabError, match=r"random: .*Gone cannot be imported"):
        check_test(config)
