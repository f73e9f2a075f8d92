"""What is in the data of a run, which may be tested on other data than it is trained on."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from tf_lab.data.sources.settings import SPLITS, Content
from tf_lab.data.sources.source import open_source
from tf_lab.errors import TFLabError
from tf_lab.support.hashes import hash_of


def content_of(data: Any, test_on: Any | None = None) -> Content:
    """What is in the data that a run uses; makes the scenes first where that says it.

    Args:
        data: settings of the source that is trained on.
        test_on: of the source whose test scenes are used; None: the same.

    Raises:
        TFLabError: scenes cannot be made, shards not be opened, or a test scene is trained on.
    """
    if test_on is None:
        return open_source(data).content()
    source = open_source(test_on, group="test_on")
    source.has("test")  # says what is wrong with it before anything is made
    trained = open_source(data).content([split for split in SPLITS if split != "test"])
    tested = source.content(("test",))
    scenes = tested.scenes.get("test", {})
    seen = trained.scenes.get("train", {})
    for name, digest in scenes.items():
        twin = next((other for other, known in seen.items() if known == digest), None)
        if twin is not None:
            raise TFLabError(
                f"test_on: {name} is trained on, too ({twin} of data={data.name}); hold it out of "
                f"the training, as by data.test=[{twin}], or test on another"
            )
    # what makes its scenes is no part of the training's versions, which shape weights
    digest = hash_of([tested.versions, tested.test], 16, sort_keys=True)
    return replace(trained, test=digest, scenes={**trained.scenes, "test": scenes})
