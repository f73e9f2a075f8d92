"""Making the schema, and the settings of all parts, known to Hydra.

The settings of interchangeable parts are options of their group by being registered.
"""

from __future__ import annotations

import functools
from dataclasses import is_dataclass

from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf

from tf_lab.config.groups import InputSettings, TrainerSettings
from tf_lab.config.schema import CONFIGS, GROUPS, PARTS, TEST_ON
from tf_lab.evaluation.registry import METRICS, PAPER
from tf_lab.support.registry import Part

OPTIONS: dict[tuple[str, str], type] = {
    ("inputs", "all"): InputSettings,
    ("trainer", "auto"): TrainerSettings,
}
"""Options of groups that are no parts, as schemas."""
COMMAND = {
    "defaults": [
        {"override /hydra/job_logging": "stdout"},
        {"override /hydra/hydra_logging": "none"},
    ],
    "hydra": {"output_subdir": None, "run": {"dir": "."}},
}
"""Of all commands: they log to the terminal, do not change the folder, and leave nothing in it."""


def register() -> None:
    """Make the schemas and the settings of all parts known to Hydra.

    Raises:
        TFLabError: parts of another package cannot be imported.
    """
    _store(tuple(part for parts in (*PARTS, METRICS) for part in parts))


@functools.cache  # a third of the time of composing a config
def _store(known: tuple[Part, ...]) -> None:
    """Store all schemas, once for the parts that are known."""
    store = ConfigStore.instance()
    store.store(group="schema", name="command", node=COMMAND, package="_global_")
    for name, schema in CONFIGS.items():
        store.store(group="schema", name=name, node=node_of(schema))
    for (group, option), settings in OPTIONS.items():
        store.store(group=group, name=option, node=node_of(settings))
    for group in GROUPS:
        for part in GROUPS[group]:
            node = node_of(part.settings)
            if group == TEST_ON:
                _size_of_training(node)
            store.store(group=group, name=part.choice, node=node)
    for part in METRICS:
        if part.name not in PAPER:  # those are always there
            node = node_of(part.settings)
            store.store(
                group="metrics", name=part.choice, node=node, package=f"metrics.{part.name}"
            )


def _size_of_training(node: DictConfig) -> None:
    """Images that a network is tested on are of the size that it is trained on, unless given."""
    for side in ("width", "height"):
        if side in node:
            node[side] = f"${{oc.select:data.{side},{node[side]}}}"


def node_of(schema: type) -> DictConfig:
    """A structured config that Hydra may fill in, although the dataclass is frozen."""
    node = OmegaConf.structured(schema)
    OmegaConf.set_readonly(node, None)
    for key in node:
        inner = node._get_node(key)
        if isinstance(inner, DictConfig) and is_dataclass(kind := inner._metadata.ref_type):
            if inner._is_missing():
                node[key] = node_of(kind)
            else:
                OmegaConf.set_readonly(inner, None)
    return node
