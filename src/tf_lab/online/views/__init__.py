"""Which views a voxel keeps: policies, the store of what is kept, the batch form of training."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tf_lab.online.views.settings import AttentionSettings, DiverseSettings, RandomSettings
from tf_lab.support.registry import Part, Registry

if TYPE_CHECKING:
    from tf_lab.online.views.selection import SelectionPolicy


@dataclass(frozen=True)
class PolicyPart(Part):
    """A policy of view selection by name.

    Attributes:
        label: how a row of the tables tells it from the paper's attention, after "16 images".
    """

    label: str = ""


POLICIES: Registry[PolicyPart] = Registry("select", "policy")
_HERE = "tf_lab.online.views.selection"
for _part in (
    PolicyPart("attention", f"{_HERE}:AttentionSelection", AttentionSettings, "attn"),
    PolicyPart("random", f"{_HERE}:RandomSelection", RandomSettings, "rnd", label="RND"),
    PolicyPart("diverse", f"{_HERE}:DiverseSelection", DiverseSettings, label="diverse (ours)"),
):
    POLICIES.add(_part)


def make_policy(settings: Any, seed: int) -> SelectionPolicy:
    """The policy that settings (or a name, or a mapping) describe.

    Raises:
        TFLabError: there is none.
    """
    return POLICIES.make(settings, seed)
