"""EfficientNet-Lite0 by its published table, and made-up weights for it."""

import torch
from torch import Tensor

# Tan and Le 2019, table 1: kernel, expansion, stride, channels, layers; lite keeps these of B0
TABLE = (
    *((3, 1, 1, 16, 1), (3, 6, 2, 24, 2), (5, 6, 2, 40, 2), (3, 6, 2, 80, 3)),
    *((5, 6, 1, 112, 3), (5, 6, 2, 192, 4), (3, 6, 1, 320, 1)),
)


def blocks() -> list[tuple[int, int, int, int, int]]:
    """Of the table, a row a block: inputs, outputs, kernel, stride, expansion."""
    rows, inputs = [], 32
    for kernel, expansion, stride, outputs, layers in TABLE:
        for i in range(layers):
            rows.append((inputs, outputs, kernel, stride if i == 0 else 1, expansion))
            inputs = outputs
    return rows


def published_shapes() -> dict[str, tuple[int, ...]]:
    """Name -> shape of what the weights have of the trunk, by the table."""
    shapes: dict[str, tuple[int, ...]] = {"_conv_stem.weight": (32, 3, 3, 3)}

    def norm(name: str, channels: int) -> None:
        for key in ("weight", "bias", "running_mean", "running_var"):
            shapes[f"{name}.{key}"] = (channels,)
        shapes[f"{name}.num_batches_tracked"] = ()

    norm("_bn0", 32)
    for i, (inputs, outputs, kernel, _, expansion) in enumerate(blocks()):
        inner, name = inputs * expansion, f"_blocks.{i}"
        if expansion != 1:
            shapes[f"{name}._expand_conv.weight"] = (inner, inputs, 1, 1)
            norm(f"{name}._bn0", inner)
        shapes[f"{name}._depthwise_conv.weight"] = (inner, 1, kernel, kernel)
        norm(f"{name}._bn1", inner)
        shapes[f"{name}._project_conv.weight"] = (outputs, inner, 1, 1)
        norm(f"{name}._bn2", outputs)
    return shapes


def made_up(seed: int = 0) -> dict[str, Tensor]:
    """Weights of the whole published network, classifier and all."""
    torch.manual_seed(seed)
    state: dict[str, Tensor] = {}
    for name, shape in published_shapes().items():
        scale = max(1, torch.Size(shape[1:]).numel()) ** -0.5
        values = torch.randn(shape) * scale
        state[name] = values.abs() + 0.5 if name.endswith("var") else values
        if name.endswith("tracked"):
            state[name] = torch.tensor(3)
    state["_conv_head.weight"] = torch.randn(1280, 320, 1, 1)
    state["_bn1.weight"] = torch.randn(1280)
    state["_fc.weight"], state["_fc.bias"] = torch.randn(1000, 1280), torch.randn(1000)
    return state
