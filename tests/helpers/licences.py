"""What of other people tf_lab needs, under which licences, as their packages' metadata say.

    PYTHONPATH=$PWD/src:$PWD/tests python -m helpers.licences [EXTRA ...]

Prints a table with what is copyleft in front; libraries inside of a wheel are not in metadata.
"""

from __future__ import annotations

import re
import sys
import tomllib
from importlib.metadata import distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PYPROJECT = Path(__file__).resolve().parents[2] / "pyproject.toml"
OWN = "tf-lab"
COPYLEFT = re.compile(r"\b[AL]?GPL|General Public|\bMPL|Mozilla|\bEUPL|\bCDDL|\bEPL|Eclipse Public")
CHOICE = re.compile(r"\sor\s", re.IGNORECASE)  # as in "GPL-2.0 OR MIT"


def dependencies(*extras: str) -> list[str]:
    """The packages that tf_lab needs here, directly or not, with some of its extras; sorted."""
    project = tomllib.loads(PYPROJECT.read_text())["project"]
    asked = {"": project["dependencies"], **project["optional-dependencies"]}
    todo, seen = [(OWN, extra) for extra in ("", *extras)], set()
    while todo:
        owner, extra = todo.pop()
        if (owner, extra) in seen:
            continue
        seen.add((owner, extra))
        texts = asked[extra] if owner == OWN else distribution(owner).requires or []
        for needed in map(Requirement, texts):
            if needed.marker is None or needed.marker.evaluate({"extra": extra}):
                name = canonicalize_name(needed.name)
                todo += [(name, wanted) for wanted in ("", *needed.extras)]
    return sorted({name for name, _ in seen} - {OWN})


def licence(name: str) -> str:
    """Of an installed package: its expression, else its classifiers, else what it calls it."""
    data = distribution(name).metadata
    classified = [
        text.rpartition(" :: ")[2]
        for text in data.get_all("Classifier", [])
        if text.startswith("License ::") and not text.endswith("OSI Approved")
    ]
    said = (data.get("License") or "").strip().partition("\n")[0]
    return data.get("License-Expression") or " and ".join(classified) or said or "not said"


def is_copyleft(text: str) -> bool:
    """Whether a licence asks that what is made with it be under it, and gives no other choice."""
    return COPYLEFT.search(text) is not None and not any(
        COPYLEFT.search(choice) is None for choice in CHOICE.split(text)
    )


def main() -> None:
    """Print the table."""
    rows = [(name, licence(name)) for name in dependencies(*sys.argv[1:])]
    for name, text in sorted(rows, key=lambda row: not is_copyleft(row[1])):
        version = distribution(name).version
        print(f"{'copyleft' if is_copyleft(text) else '':8}  {name} {version}  {text}")


if __name__ == "__main__":
    main()
