"""A GPU played by the CPU: finds tensors on the wrong device, and counts what waits for the GPU.

Tensors "on the GPU" are CPU tensors of a class of their own. Every call of torch passes through
`PretendedGpu`, which refuses to mix them with the host's, as CUDA does.
"""

from collections import Counter
from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode, resolve_name
from torch.utils._pytree import tree_leaves, tree_map

CUDA = torch.device("cuda")
# what makes the host wait until the GPU has come so far
WAITS = {
    *("item", "tolist", "numpy", "cpu", "nonzero", "unique", "masked_select", "new_tensor"),
    *("__bool__", "__int__", "__float__", "__index__"),
}
CROSSES = {"to", "cpu", "copy_"}


class OnGpu(Tensor):
    """Says that it is on a GPU."""

    @property
    def device(self) -> torch.device:  # type: ignore[override]
        return CUDA


def on_gpu(network: nn.Module) -> Any:
    """A network, in place, with its weights on the GPU."""
    for module in network.modules():
        for tensors in (module._parameters, module._buffers):
            for name, tensor in tensors.items():
                if tensor is not None:
                    tensors[name] = tensor.detach().as_subclass(OnGpu)  # type: ignore[assignment]
    return network


class PretendedGpu(TorchFunctionMode):
    """While it is entered, there is a GPU. ``waits`` counts, by function, where the host waits."""

    def __init__(self) -> None:
        super().__init__()
        self.waits: Counter[str] = Counter()

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        if func is torch.device:
            return func(*args, **kwargs)
        name = (resolve_name(func) or func.__name__).rsplit(".", 1)[-1]
        tensors = [x for x in tree_leaves((args, kwargs)) if isinstance(x, Tensor)]
        gpu = any(isinstance(x, OnGpu) for x in tensors)
        if name == "pin_memory":
            return args[0]
        target = _target(name, args, kwargs)
        if gpu and name not in CROSSES:
            strangers = [x for x in tensors if not isinstance(x, OnGpu) and x.dim() > 0]
            assert not strangers, f"{name} mixes devices"
        upload = target == CUDA and not gpu and (tensors or name in ("tensor", "as_tensor"))
        if (upload and not kwargs.get("non_blocking")) or (gpu and _waits(name, args)):
            self.waits[name] += 1
        if "device" in kwargs:
            kwargs["device"] = None if kwargs["device"] is None else "cpu"
        args, kwargs = tree_map(_to_host, (args, kwargs))
        result = func(*args, **kwargs)
        if name == "numpy":
            assert not gpu, "numpy of a GPU's tensor"
        if (target or (CUDA if gpu else None)) != CUDA or isinstance(result, torch.Size):
            return result
        if isinstance(result, Iterator):
            result = list(result)
            return iter(tree_map(_to_gpu, result))
        return tree_map(_to_gpu, result)


def _to_host(x: Any) -> Any:
    if isinstance(x, OnGpu):
        with torch._C.DisableTorchFunctionSubclass():
            return x.as_subclass(Tensor)
    return torch.device("cpu") if isinstance(x, torch.device) else x


def _to_gpu(x: Any) -> Any:
    return x.as_subclass(OnGpu) if isinstance(x, Tensor) else x


def _target(name: str, args: Any, kwargs: Any) -> torch.device | None:
    """Where the result is to be, if the call says so."""
    if name == "cpu":
        return torch.device("cpu")
    named = [kwargs.get("device"), *(args[1:2] if name == "to" else ())]
    found = [torch.device(x) for x in named if isinstance(x, str | torch.device)]
    return found[0] if found else None


def _waits(name: str, args: Any) -> bool:
    if name in ("__getitem__", "__setitem__"):  # a mask is a list whose length is not known
        leaves = tree_leaves(args[1])
        return any(isinstance(x, Tensor) and x.dtype == torch.bool for x in leaves)
    return name in WAITS or (name == "to" and _target(name, args, {}) == torch.device("cpu"))
