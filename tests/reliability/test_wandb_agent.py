"""`wandb agent` of our sweep, as far as that goes without an account: its server is made up.

The agent is wandb's own: it asks for jobs, makes the command line of the sweep's ``command`` and
starts it.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from helpers.tiny_jobs import TINY, environment

SWEEP = Path(__file__).parents[2] / "sweeps" / "wandb" / "main_ablation.yaml"
AGENT = """
import json, os, sys
from unittest.mock import patch
import wandb
from wandb import wandb_agent
from wandb.apis.public import sweeps

jobs = json.loads(sys.argv[2])
commands = [{"type": "run", "run_id": f"run{n}", "program": None, "args": args}
            for n, args in enumerate(jobs)]
commands.append({"type": "exit"})

def heartbeat(api, agent, metrics, states):
    return [] if states else [commands.pop(0)]  # one after the other

with (
    patch.object(wandb, "Api", lambda: None),
    patch.object(sweeps, "_sweep_with_runs", lambda *a: {"config": open(sys.argv[1]).read()}),
    patch.object(sweeps, "_register_agent", lambda *a, **k: {"id": "agent"}),
    patch.object(sweeps, "_agent_heartbeat", heartbeat),
):
    wandb_agent.run_agent("nobody/tf_lab/sweep")
"""


@pytest.mark.slow
def test_wandbs_agent_does_the_jobs_of_our_sweep(tmp_path: Path) -> None:
    """Two rows of one training, so that the second job has only to be tested."""
    pytest.importorskip("wandb.wandb_agent")
    settings = dict(word.split("=", 1) for word in TINY)
    rows = ("ours", "views4_rnd")
    jobs = [
        {key: {"value": value} for key, value in {"seed": 0, "row": row, **settings}.items()}
        for row in rows
    ]
    variables = environment(
        WANDB_MODE="offline",
        WANDB_SILENT="true",
        WANDB_AGENT_MAX_INITIAL_FAILURES="1",
        PATH=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
    )
    agent = [sys.executable, "-c", AGENT, str(SWEEP), json.dumps(jobs)]
    done = subprocess.run(
        agent, cwd=tmp_path, env=variables, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stderr[-2000:]
    runs = [json.loads(path.read_text()) for path in tmp_path.glob("outputs/runs/*/metrics.json")]
    assert {run["label"] for run in runs} == {"Ours", "Ours: 4 images, RND"}
    assert len([*tmp_path.glob("outputs/trainings/*/model.safetensors")]) == 1
    offline = [*tmp_path.rglob("offline-run-*")]
    assert {path.name.rpartition("-")[2] for path in offline} == {"run0", "run1"}
