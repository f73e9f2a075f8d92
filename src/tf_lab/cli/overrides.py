"""What is wrong with a command line, in one line; Hydra needs several for that."""

from __future__ import annotations

import argparse
import difflib
import re
import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Quote, QuotedString
from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from omegaconf import OmegaConf
from omegaconf.errors import ValidationError

from tf_lab.cli.help import FOUND_OUT, also, is_within
from tf_lab.config.schema import GROUPS, TEST_ON
from tf_lab.errors import TFLabError
from tf_lab.evaluation.registry import METRICS, PAPER
from tf_lab.experiments.launcher import JOB, task_overrides


def is_sweep(given: argparse.Namespace) -> bool:
    """Whether a command line asks for several jobs."""
    asked = given.multirun or any(
        word == "hydra.mode=MULTIRUN" or (word.startswith("sweep=") and word != "sweep=null")
        for word in given.overrides
    )
    return asked and JOB not in given.overrides


def check(unused: Sequence[str] = (), replaced: Mapping[str, Sequence[str]] | None = None) -> None:
    """That the settings given to the command whose job is running are of use.

    Args:
        unused: settings (or groups of them) that the command does not read. A choice among a
            group's options may still say something else.
        replaced: settings (or groups) that are not read either, by the given one that takes their
            place. The choice of the data is still of use: tests of the network's data need none.

    Raises:
        TFLabError: one is not.
    """
    job = HydraConfig.get()
    for override in OverridesParser.create().parse_overrides(task_overrides(job)):
        name = override.key_or_group
        if is_within(name, (*unused, FOUND_OUT)) and name not in job.runtime.choices:
            raise TFLabError(f"{override.input_line}: tf_lab.{job.job.config_name} does not use it")
        for given, names in (replaced or {}).items():
            if is_within(name, names) and name != "data":
                unread = f"tf_lab.{job.job.config_name} does not use it with {given}="
                raise TFLabError(f"{override.input_line}: {unread}")
        if is_within(name, ["launcher"]) and JOB not in sys.argv:
            raise TFLabError(f"{override.input_line} needs a sweep: add -m or sweep=NAME")


def check_groups(overrides: Sequence[str], conf: Path) -> None:
    """That no group is set to nothing, which Hydra answers with a traceback.

    Raises:
        TFLabError: one is.
    """
    for word in overrides:
        group, _, choice = word.lstrip("+").partition("=")
        options = {path.stem for path in (conf / group).glob("*.yaml")}
        parts = [*GROUPS[group]] if group in GROUPS else []
        parts += [*METRICS] if group == METRICS.group else []
        options |= {part.choice for part in parts if part.name not in PAPER}
        if group == "metrics" and choice.startswith("["):  # Hydra would say it in five lines
            named = [part.strip() for part in choice.strip("[]").split(",") if part.strip()]
            known = [part.choice for part in METRICS if part.name not in PAPER]
            for name in named:
                if name not in known:
                    raise TFLabError(f"{word}: no {name} among the metrics: {', '.join(known)}")
        if "null" in choice.split(",") and options:
            there = ", ".join(sorted(options))
            raise TFLabError(f"{word}: choose one of {there}, or leave it out")


UNSET = ("hydra", FOUND_OUT)  # what nobody sets by a name
_WANTED = {
    "Integer": "a whole number",
    "Float": "a number",
    "List": "a list, as in 'NAME=[a,b]'",
    "bool": "true or false",
}


def _wanted(error: BaseException | None) -> str:
    """What a value should be that the schema does not take."""
    text = str(error).splitlines()[0]
    if "not Optional" in text:
        return "given"
    return next((wanted for name, wanted in _WANTED.items() if name in text), f"another: {text}")


def explain(
    error: Exception,
    conf: Path,
    name: str,
    overrides: Sequence[str] = (),
    own: str | None = None,
) -> str:
    """An error of Hydra in one line: what is wrong, and what there is.

    Args:
        error: what Hydra raised.
        conf: the directory of the configs.
        name: of the command and its config.
        overrides: of the command line.
        own: the user's own directory of configs.
    """
    chosen = _choices(overrides, conf)
    options = [] if own is None else [f"--config-dir={own}"]
    command = shlex.join(["python", "-m", f"tf_lab.{name}", *options, *chosen])
    more = f"`{command} --help` lists all"
    text = str(error) or str(error.__cause__)
    if isinstance(error, MissingConfigException) and error.missing_cfg_file and error.options:
        group, _, choice = error.missing_cfg_file.rpartition("/")
        like = difflib.get_close_matches(choice, error.options, 1)
        meant = f"did you mean {group}={like[0]}? " if like else ""
        return f"{group}={choice}: no such choice; {meant}there are {', '.join(error.options)}"
    if isinstance(error, OverrideParseException):
        if "=" not in error.override:
            return f"{error.override}: not of the form NAME=VALUE; {more}"
        reason = text.splitlines()[0]
        key, _, value = error.override.partition("=")
        quoted = shlex.quote(f"{key}={QuotedString(value, Quote.double).with_quotes()}")
        return f"{error.override}: cannot be read ({reason}); if it is text, write {quoted}"
    if isinstance(cause := error.__cause__, ValidationError):
        refused = re.match(r"Error merging override (.+)", text, re.S)
        where = refused[1] if refused else getattr(cause, "full_key", "") or ""
        return f"{where}: must be {_wanted(cause)}"
    if unknown := re.search(r"Could not override '([^'@]+)", text):
        key = unknown.group(1)
        none = not any(word.startswith(f"{TEST_ON}=") for word in chosen)
        if name == "train" and key.startswith(f"{TEST_ON}.") and none:
            return f"{key}: {_test_on_first(overrides)}"
        meant = _nearest(key, conf, name, [*chosen, *also(own)])
        return f"{key}: no such setting of tf_lab.{name}{meant}; {more}"
    if several := re.match(r"Ambiguous value for argument '(.+)'\n", text):
        key, _, values = several.group(1).partition("=")
        whole = shlex.quote(f"{key}=[{values}]")
        return f"{key}={values}: add -m to run each of them, or write {whole} for a list"
    return " ".join(text.split())


def _test_on_first(overrides: Sequence[str]) -> str:
    """What to do about a setting of the data to test on, of which there is none."""
    if any(word.startswith(f"{TEST_ON}=") for word in overrides):  # several: a sweep
        return f"settings of {TEST_ON} are of one choice; give each of {TEST_ON} a sweep of its own"
    return f"choose the data to test on, too, as by {TEST_ON}=captures"


def _choices(overrides: Sequence[str], conf: Path) -> list[str]:
    """The overrides that choose one option of a group, on which the settings depend."""
    groups = {*GROUPS, *(path.name for path in conf.iterdir() if path.is_dir())}
    return [word for word in overrides if re.fullmatch(rf"({'|'.join(groups)})=\w+", word)]


def _nearest(key: str, conf: Path, name: str, chosen: list[str]) -> str:
    """A question: the settings that may have been meant, if any is like it."""
    with initialize_config_dir(str(conf), version_base="1.3"):
        try:
            cfg = compose(name, chosen, return_hydra_config=True)
        except HydraException:  # a choice that another command has
            cfg = compose(name, return_hydra_config=True)
    values = OmegaConf.to_container(cfg)
    assert isinstance(values, dict)
    names = [*_names(values), *cfg.hydra.runtime.choices]
    known = dict.fromkeys(n for n in names if not is_within(n, UNSET) and n != key)
    same = [k for k in known if k.rpartition(".")[2] == key.rpartition(".")[2]]
    meant = same or difflib.get_close_matches(key, known, 2)
    return f" (did you mean {' or '.join(meant)}?)" if meant else ""


def _names(values: dict[Any, Any], prefix: str = "") -> Iterator[str]:
    """The dotted names of all settings."""
    for key, value in values.items():
        yield f"{prefix}{key}"
        if isinstance(value, dict):
            yield from _names(value, f"{prefix}{key}.")
