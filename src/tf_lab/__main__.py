"""tf_lab: video with known poses to a mesh; its commands are modules.

python -m tf_lab.COMMAND [NAME=VALUE ...], and --help for the settings of each
"""

from __future__ import annotations

import ast
import difflib
import os
import sys
from pathlib import Path

from tf_lab.cli.command import print_anything

COMMANDS = (
    "reconstruct",
    "check",
    "view",
    "train",
    "pretrain",
    "pretrain_stereo",
    "prepare",
    "evaluate",
    "report",
    "figures",
    "runs",
    "benchmark",
)


def main() -> None:
    """List the commands; the exit status is 0 if that was asked for, else 2."""
    print_anything()
    words = sys.argv[1:]
    if not words or {"-h", "--help"}.intersection(words):
        try:
            print(listing(), flush=True)
        except BrokenPipeError:  # whoever reads has seen enough
            os._exit(1)
        sys.exit(0 if words else 2)
    print(f"error: {_cure(words[0])}", file=sys.stderr)
    sys.exit(2)


def listing() -> str:
    """The commands with what each does, a line each."""
    width = max(map(len, COMMANDS))
    lines = (f"  python -m tf_lab.{name:{width}}  {_about(name)}" for name in COMMANDS)
    return "\n".join([(__doc__ or "").strip(), "", *lines])


def _about(name: str) -> str:
    """The first line of a command's help; read, because importing some takes a second."""
    source = Path(__file__).with_name(f"{name}.py").read_text(encoding="utf-8")
    return (ast.get_docstring(ast.parse(source)) or "").splitlines()[0]


def _cure(word: str) -> str:
    like = difflib.get_close_matches(word.removeprefix("tf_lab."), COMMANDS, 1)
    if not like:
        return f"{word}: no such command; `python -m tf_lab --help` lists all"
    return f"{word}: commands are modules, call python -m tf_lab.{like[0]}"


if __name__ == "__main__":
    main()
