"""Settings of the policies of view selection."""

from __future__ import annotations

from dataclasses import dataclass

from tf_lab.support.settings import setting

POLICY = "which views a voxel keeps"


@dataclass(frozen=True)
class AttentionSettings:
    """The views of highest attention weight."""

    policy: str = setting("attention", POLICY, shapes="scores")


@dataclass(frozen=True)
class RandomSettings:
    """A random sample of the views that see a voxel."""

    policy: str = setting("random", POLICY, shapes="scores")


@dataclass(frozen=True)
class DiverseSettings:
    """A random sample that attention prefers, another at every voxel (ours)."""

    policy: str = setting("diverse", POLICY, shapes="scores")
    attention: float = setting(
        1.0,
        "share of the attention logits; 0: chance alone, 1: views are drawn by their weights",
        shapes="scores",
        least=0,
    )
    spread: float = setting(
        0.0, "share of the log angle to the nearest other view; 0: none", shapes="scores", least=0
    )
