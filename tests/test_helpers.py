"""What tests share lies in tests/helpers, and only there."""

import ast
from pathlib import Path

TESTS = Path(__file__).parent


def imported(path: Path) -> set[str]:
    """The modules that a file imports."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add(f"{node.module}")
    return found


def test_no_test_imports_another() -> None:
    folders = {path.name for path in TESTS.iterdir() if path.is_dir()} - {"helpers"}
    assert {"data", "network"} <= folders
    for path in TESTS.rglob("*.py"):
        for module in imported(path):
            first, last = module.split(".")[0], module.split(".")[-1]
            assert first not in folders, f"{path}: {module}"
            assert not last.startswith("test_"), f"{path}: {module}"
            assert last != "conftest", f"{path}: {module}"
