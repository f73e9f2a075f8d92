"""What is installed is what was tested, in its bytes; and under which licences it is."""

import re

import pytest

from helpers.licences import PYPROJECT, dependencies, is_copyleft, licence

FILES = {"certifi", "tqdm"}  # of copyleft that ends at its own files (MPL)


def pins(name: str) -> dict[str, str]:
    """Versions by names, of a file of pip's beside pyproject.toml."""
    found = re.findall(r"(?m)^([\w.-]+)==(\S+)", (PYPROJECT.parent / name).read_text())
    return {re.sub(r"[-_.]+", "-", package).lower(): version for package, version in found}


def test_constraints_are_complete_and_those_of_the_lock_file() -> None:
    constraints, lock = pins("constraints.txt"), pins("requirements.lock")
    assert not {*dependencies("dev")} - {*constraints}
    assert lock == {name: v for name, v in constraints.items() if name != "torch"}
    for entry in re.split(
        r"(?m)^(?=[\w.-]+==)", (PYPROJECT.parent / "requirements.lock").read_text()
    )[1:]:
        assert re.search(r"--hash=sha256:[0-9a-f]{64}", entry), entry


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("GPL-3.0-or-later", True), ("LGPL-2.1", True), ("GNU General Public License v3", True),
        ("Mozilla Public License 2.0 (MPL 2.0)", True), ("MPL-2.0 AND MIT", True), ("MIT", False),
        ("GPL-2.0-only OR MIT", False), ("LGPL-3.0 OR GPL-3.0", True), ("Apache-2.0", False),
    ],
)  # fmt: skip
def test_what_is_copyleft(text: str, expected: bool) -> None:
    assert is_copyleft(text) == expected


def test_nothing_that_tf_lab_needs_is_copyleft_beyond_its_own_files() -> None:
    found = {name: licence(name) for name in dependencies("decimate", "viewer", "imagenet")}
    assert not [name for name, text in found.items() if text == "not said"]
    strict = {name: text for name, text in found.items() if is_copyleft(text) and name not in FILES}
    assert not strict
