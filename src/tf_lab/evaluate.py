"""Evaluate meshes in the published layout.

python -m tf_lab.evaluate predictions=DIR groundtruth=DIR [output=FILE.json]
"""

from __future__ import annotations

import functools
from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console
from rich.progress import track

from tf_lab.commands import command
from tf_lab.errors import TFLabError
from tf_lab.evaluation.protocol import evaluate, format_table
from tf_lab.files import write_json


@command("evaluate")
def main(cfg: DictConfig) -> None:
    """Print the paper's metrics of every scene and their mean; write them if asked to."""
    predictions, groundtruth = Path(str(cfg.predictions)), Path(str(cfg.groundtruth))
    output = Path(str(cfg.output)) if cfg.output is not None else None
    if output is not None and output.is_dir():
        raise TFLabError(f"{output}: is a folder; output=FILE.json names a file")
    bar = functools.partial(track, description="evaluating", console=Console(stderr=True))
    result = evaluate(predictions, groundtruth, seed=cfg.seed, track=bar)
    print(format_table([*result["scenes"].items(), ("mean", result["mean"])], first="Scene"))
    if output is not None:
        write_json(output, result)
    if result["missing"]:
        print("no prediction, scored as empty: " + ", ".join(result["missing"]))
    if result["failed"]:
        reasons = "; ".join(result["failed"].values())
        raise TFLabError(f"{len(result['failed'])} scene(s) left out of the mean: {reasons}")


if __name__ == "__main__":
    main()
