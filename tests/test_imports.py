"""Who imports whom: rooms only those below them, nothing in a circle, nothing slow for help."""

import ast
import importlib.util
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import tf_lab

PACKAGE = Path(tf_lab.__file__).parent
# from the ground up; those of a floor do not know each other
FLOORS: tuple[tuple[str, ...], ...] = (
    ("errors",),
    ("support",),
    ("geometry",),
    ("meshes", "stereo"),
    ("network", "data"),
    ("poses", "online"),
    ("evaluation",),
    ("config",),
    ("experiments",),
    ("reporting",),
    ("training", "viewer"),
    ("benchmarks",),
    ("cli", "commands"),
)
FLOOR = {name: floor for floor, names in enumerate(FLOORS) for name in names}
SLOW = {
    "torch",
    "lightning",
    "matplotlib",
    "trimesh",
    "scipy",
    "cv2",
    "torchmetrics",
    "skimage",
    "viser",
}


def modules() -> dict[str, Path]:
    """Every module by its dotted name."""
    found = {}
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


MODULES = modules()


def imports(name: str, everywhere: bool) -> Iterator[str]:
    """The modules of ours that one imports: when it is itself imported, or also in functions."""
    tree = ast.parse(MODULES[name].read_text())
    nodes = ast.walk(tree) if everywhere else iter(tree.body)
    for node in nodes:
        if isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in MODULES else node.module
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


@pytest.mark.parametrize("name", sorted(MODULES))
def test_imports_point_down(name: str) -> None:
    room = [*name.split("."), ""][1]
    for other in imports(name, everywhere=True):
        parts = other.split(".")
        if parts[0] != "tf_lab" or len(parts) == 1 or room not in FLOOR or parts[1] == room:
            continue
        assert FLOOR[parts[1]] < FLOOR[room], f"{name} imports {other}"


def test_every_room_has_a_floor() -> None:
    assert {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists()} == (
        set(FLOOR) - {"errors"}
    )


def test_no_circle() -> None:
    graph = {name: set(imports(name, everywhere=False)) & set(MODULES) for name in MODULES}
    left = dict(graph)
    while ready := [name for name, needs in left.items() if not needs & set(left)]:
        for name in ready:
            del left[name]
    assert left == {}


def test_the_top_is_commands() -> None:
    """At most fifteen modules there: twelve commands, their list, the names, the error."""
    assert len(list(PACKAGE.glob("*.py"))) <= 15


SHORT = (
    *(["train", "--help"], ["report", "--help"], ["reconstruct", "--help"], ["check", "-h"]),
    ["view", "--help"],
    *(["train", "sede=1"], ["evaluate", "predictions=a"], ["runs", "--output=nowhere"]),
    ["report", "runs=nowhere"],
)


def test_what_takes_time_is_not_imported_for_a_word(tmp_path: Path) -> None:
    """Help, errors of the command line, and runs: one process does them all, one after another."""
    code = (
        "import importlib, sys\n"
        f"for command, *given in {SHORT}:\n"
        "    sys.argv = [f'tf_lab/{command}.py', *given]\n"
        "    try: importlib.import_module(f'tf_lab.{command}').main()\n"
        "    except SystemExit: pass\n"
        f"    print('SLOW:', command, given, sorted({SLOW} & set(sys.modules)))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True
    )
    found = [line for line in done.stdout.splitlines() if line.startswith("SLOW:")]
    assert len(found) == len(SHORT), done.stderr
    assert [line for line in found if not line.endswith(" []")] == []


def test_only_training_knows_lightning() -> None:
    assert importlib.util.find_spec("lightning")
    names = ("evaluate", "reconstruct", "check", "prepare", "report", "benchmark")
    code = (
        f"import importlib, sys\nfor name in {names}:\n"
        "    importlib.import_module(f'tf_lab.commands.{name}')\n"
        "    assert 'lightning' not in sys.modules, name\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
