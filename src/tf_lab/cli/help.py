"""``--help`` of every command: its docstring, its choices, and its settings with their meaning."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from hydra import compose, initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Quote, QuotedString
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException

from tf_lab.config.typed import settings_of

FOUND_OUT = "content"  # of the data, when a run begins
USUAL = 34  # characters of a name; few are longer
CHOICES = "Choices (* those in use; the settings below are theirs):"
SETTINGS = "Settings and their values (???: has to be given):"
MORE = """\
--cfg job prints the whole config and ends. An error is one line; TF_LAB_DEBUG=1 adds the traceback.
More in README.md and, on data, in docs/data.md."""


def help_text(
    conf: Path,
    name: str,
    about: str,
    overrides: Sequence[str] = (),
    unused: Sequence[str] = (),
    own: str | None = None,
) -> str:
    """What a command does, its choices, and its settings with value and comment.

    Args:
        conf: the directory of the configs.
        name: of the command and its config.
        about: what it does and how it is called.
        overrides: given beside ``--help``: they are in the values shown.
        unused: settings (or groups of them) that the command does not read.
        own: the user's own directory of configs.
    """
    with initialize_config_dir(str(conf), version_base="1.3"):
        given = [*one_job(overrides), *also(own)]
        cfg = compose(name, given, return_hydra_config=True)
        loader = GlobalHydra.instance().config_loader()
        groups = reversed(cfg.hydra.runtime.choices.items())  # in the order of the config
        picked = {group: [option] for group, option in groups if not group.startswith("hydra/")}
        if "metrics" in cfg:  # of which there may be several, or none
            picked["metrics"] = list(cfg.metrics)
        shown = [group for group in picked if group not in unused]
        options = [
            (group, option)
            for group in shown
            for option in loader.get_group_options(group, config_name=name, overrides=given)
        ]
    places = [conf] if own is None else [Path(own), conf]
    choices = [
        (f"{'*' if o in picked[g] else ' '} {g}={o}", _summary(places, g, o)) for g, o in options
    ]
    meanings = {key: field.metadata.get("about", "") for key, field in settings_of(cfg)}
    with open_dict(cfg):
        del cfg["hydra"]
    values = OmegaConf.to_container(cfg)
    assert isinstance(values, dict)
    leaves = [(key, _resolved(cfg, key, value)) for key, value in _leaves(values)]
    settings = [
        (f"  {key}={value}", meanings.get(key, ""))
        for key, value in sorted(leaves, key=lambda leaf: "." in leaf[0])
        if not is_within(key, (*unused, FOUND_OUT))
    ]
    parts = [about.strip()]
    parts += ["\n".join([CHOICES, *_columns(choices)])] if choices else []
    return "\n\n".join([*parts, "\n".join([SETTINGS, *_columns(settings)]), MORE])


def also(own: str | None) -> list[str]:
    """The override by which Hydra's compose looks into a user's own directory of configs, too."""
    if own is None:
        return []
    place = QuotedString(f"file://{Path(own).absolute()}", Quote.single).with_quotes()
    return [f"hydra.searchpath=[{place}]"]


def one_job(overrides: Sequence[str]) -> list[str]:
    """Overrides without those that make several jobs, in which settings differ."""
    parser = OverridesParser.create()
    return [word for word in overrides if not parser.parse_override(word).is_sweep_override()]


def is_within(key: str, groups: Sequence[str]) -> bool:
    """Whether a setting is one of, or in one of, these."""
    return any(key == group or key.startswith(f"{group}.") for group in groups)


def _summary(places: Sequence[Path], group: str, option: str) -> str:
    """What a choice is: the first comment of its file, or the docstring of its settings."""
    files = (place / group / f"{option}.yaml" for place in places)
    path = next((file for file in files if file.is_file()), None)
    if path is not None:
        lines = [
            line
            for line in path.read_text(encoding="utf-8").splitlines()
            if not line.startswith("# @")
        ]
        return lines[0].lstrip("# ") if lines and lines[0].startswith("#") else ""
    found = ConfigStore.instance().load(f"{group}/{option}.yaml")
    return (OmegaConf.get_type(found.node).__doc__ or "").splitlines()[0]


def _leaves(values: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Every setting's dotted name and its value as it is written on a command line."""
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", _written(value)


def _written(value: Any) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, width=10_000)
    return text.removesuffix("...\n").strip()


def _resolved(cfg: DictConfig, key: str, value: str) -> str:
    """A value with those of other settings in it, unless one has to be given."""
    if "${" not in value:
        return value
    try:
        found = OmegaConf.select(cfg, key, throw_on_missing=True)
        plain = OmegaConf.is_config(found)
        return _written(OmegaConf.to_container(found, resolve=True) if plain else found)
    except OmegaConfBaseException:
        return value


def _columns(rows: Sequence[tuple[str, str]]) -> Iterator[str]:
    """Lines of two columns; the first is as wide as most of its texts need."""
    width = max((len(left) for left, _ in rows if len(left) <= USUAL), default=0)
    return (f"{left:{width}}  {right}".rstrip() for left, right in rows)
