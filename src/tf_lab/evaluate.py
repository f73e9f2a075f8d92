"""Evaluate meshes in the published layout.

python -m tf_lab.evaluate predictions=DIR groundtruth=DIR [output=FILE.json]
"""

from __future__ import annotations

import functools
from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console
from rich.progress import track

from tf_lab.cli.command import command
from tf_lab.errors import TFLabError
from tf_lab.evaluation.protocol import evaluate
from tf_lab.evaluation.scores import format_table
from tf_lab.support.files import check_file, write_json


@command("evaluate")
def main(cfg: DictConfig) -> None:
    """Print the paper's metrics of every scene and their mean; write them if asked to."""
    predictions, groundtruth = Path(cfg.predictions), Path(cfg.groundtruth)
    output = Path(cfg.output) if cfg.output is not None else None
    if output is not None:
        check_file(output)
    bar = functools.partial(track, description="evaluating", console=Console(stderr=True))
    result = evaluate(predictions, groundtruth, seed=cfg.seed, track=bar)
    print(format_table([*result["scenes"].items(), ("mean", result["mean"])], first="Scene"))
    if output is not None:
        write_json(output, result)
    if result["missing"]:
        print("no prediction, scored as empty: " + ", ".join(result["missing"]))
    if result["point_clouds"]:
        print("no surface, scored by the points as they are: " + ", ".join(result["point_clouds"]))
    for name, remark in result["wrong_scale"].items():
        print(f"warning: {name} is {remark}")
    if result["failed"]:
        reasons = "; ".join(result["failed"].values())
        raise TFLabError(f"{len(result['failed'])} scene(s) left out of the mean: {reasons}")


if __name__ == "__main__":
    main()
