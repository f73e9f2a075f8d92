"""Parts by name: what is found, made and refused."""

from dataclasses import dataclass

import pytest

from tf_lab.errors import TFLabError
from tf_lab.support.registry import Part, Registry
from tf_lab.support.settings import setting


@dataclass(frozen=True)
class RootSettings:
    """The n-th root."""

    kind: str = setting("root", "of function")
    n: int = setting(2, "which root")


@dataclass(frozen=True)
class GoneSettings:
    """Of what is not there."""

    kind: str = setting("gone", "of function")


@dataclass(frozen=True)
class PlainSettings:
    """One of them says nothing of itself."""

    kind: str = setting("plain", "of function")
    n: int = 2


class NoSettings:
    """No dataclass."""


@dataclass(frozen=True)
class NamelessSettings:
    """Without the name."""

    n: int = setting(2, "which root")


def root(x: float, n: int) -> float:
    return x ** (1 / n)


@pytest.fixture
def functions() -> Registry[Part]:
    found: Registry[Part] = Registry("function", "kind")
    found.add(Part("root", f"{__name__}:root", RootSettings))
    found.add(Part("gone", "no.such:thing", GoneSettings, option="away"))
    return found


@pytest.mark.parametrize("given", ["root", {"kind": "root"}, {"kind": "root", "n": 2}])
def test_settings_by_name_and_mapping(functions: Registry[Part], given: object) -> None:
    assert functions.settings(given) == RootSettings()
    assert functions.make(given, 49.0) == pytest.approx(7)


def test_settings_that_are_there_stay(functions: Registry[Part]) -> None:
    cube = RootSettings(n=3)
    assert functions.settings(cube) is cube
    assert functions.named(cube).name == "root"
    assert functions.make(cube, 27.0) == pytest.approx(3)


def test_names(functions: Registry[Part]) -> None:
    assert [part.choice for part in functions] == ["root", "away"]
    assert "root" in functions and "away" not in functions


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("sine", "function.kind=sine: choose one of root, gone"),
        ({"n": 3}, "function.kind=: choose one of root, gone"),
        ({"kind": "root", "m": 3}, "function=root: .*'m'"),
        ("gone", "no.such:thing cannot be imported"),
    ],
)
def test_what_is_not_there(functions: Registry[Part], given: object, told: str) -> None:
    with pytest.raises(TFLabError, match=told):
        functions.make(given, 1.0)


@pytest.mark.parametrize(
    ("part", "told"),
    [
        (Part("a.b", "m:f", RootSettings), "function=a.b: name it by letters"),
        (Part("copied", "m:f", RootSettings), "RootSettings.kind is 'root' by default; .*'copied'"),
        (Part("plain", "m:f", PlainSettings), "PlainSettings.n is to be made by setting"),
        (Part("none", "m:f", NoSettings), "NoSettings is no dataclass"),
        (Part("nameless", "m:f", NamelessSettings), "NamelessSettings.kind is missing"),
    ],
)
def test_a_part_that_would_not_work_is_refused(
    functions: Registry[Part], part: Part, told: str
) -> None:
    with pytest.raises(TFLabError, match=told):
        functions.add(part)


def test_what_a_setting_shapes_is_one_of_three() -> None:
    with pytest.raises(TFLabError, match=r"shapes='weight': .* weights, scores, nothing"):
        setting(1, "layers", shapes="weight")  # type: ignore[arg-type]


def test_two_parts_of_a_name(functions: Registry[Part]) -> None:
    functions.add(functions["root"])  # the same again is no harm
    with pytest.raises(TFLabError, match=r"function=root: both .*:root and other:root"):
        functions.add(Part("root", "other:root", RootSettings))
