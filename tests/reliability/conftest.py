from collections.abc import Iterator

import pytest

from helpers.faults import Case, prepare_inputs


@pytest.fixture(scope="session")
def cases(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Case]]:
    """Commands that are disturbed, and what they read. Don't write to it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TF_LAB_CACHE", "")  # is set here, and as it was afterwards
        yield prepare_inputs(tmp_path_factory.mktemp("inputs"))
