"""Settings of the fusion strategies."""

from __future__ import annotations

from dataclasses import dataclass

from tf_lab.support.settings import setting

STRATEGY = "of fusing the views of a voxel"


@dataclass(frozen=True)
class TransformerSettings:
    """The paper's: a learned token reads the views by attention."""

    strategy: str = setting("transformer", STRATEGY, shapes="weights")


@dataclass(frozen=True)
class AverageSettings:
    """A perceptron a view, then their mean."""

    strategy: str = setting("avg", STRATEGY, shapes="weights")


@dataclass(frozen=True)
class GRUSettings:
    """A recurrent network that reads the views in the order of time (ours)."""

    strategy: str = setting("gru", STRATEGY, shapes="weights")
    layers: int = setting(2, "recurrent layers", shapes="weights", least=1, most=100)


@dataclass(frozen=True)
class PredictedSettings:
    """A perceptron a view that also predicts its weight, then the weighted mean."""

    strategy: str = setting("pred", STRATEGY, shapes="weights")
