"""The student's network in torch, and the ONNX file that it becomes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import onnx
import torch
from google.protobuf.message import DecodeError
from onnx import TensorProto, helper, numpy_helper

from station.errors import BadFile
from station.protocols import Floats32

_OPSET = 17


def mlp(inputs: int, hidden: Sequence[int], outputs: int) -> torch.nn.Sequential:
    """Return layers with ELU between them."""
    widths = [inputs, *hidden, outputs]
    layers: list[torch.nn.Module] = []
    for before, after in pairwise(widths):
        layers += [torch.nn.Linear(before, after), torch.nn.ELU()]
    return torch.nn.Sequential(*layers[:-1])


class Student(torch.nn.Module):  # type: ignore[misc]
    """An MLP over inputs brought to like size.

    Args:
        inputs, outputs: Sizes.
        hidden: Widths of the hidden layers.
    """

    def __init__(self, inputs: int, hidden: Sequence[int], outputs: int) -> None:
        super().__init__()
        self.layers = mlp(inputs, hidden, outputs)
        self.mean = torch.nn.Parameter(torch.zeros(inputs), requires_grad=False)
        self.scale = torch.nn.Parameter(torch.ones(inputs), requires_grad=False)

    def measure(self, observations: Floats32) -> None:
        """Set mean and spread of the inputs from data, shape (samples, inputs)."""
        self.mean.copy_(torch.from_numpy(observations.mean(axis=0)))
        self.scale.copy_(torch.from_numpy(1.0 / np.maximum(observations.std(axis=0), 0.02)))

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Return raw actions, shape (batch, outputs)."""
        # Clamped: a value far from all that was seen must not take the whole network with it.
        return self.layers(torch.clamp((observation - self.mean) * self.scale, -8.0, 8.0))


def load_onnx(student: Student, path: Path) -> None:
    """Load mean, scale and weights from a file that `save_onnx` wrote.

    Raises:
        BadFile: no such file, no ONNX, or a network of other sizes.
    """
    try:
        graph = onnx.load(path).graph
        arrays = {item.name: torch.from_numpy(numpy_helper.to_array(item).copy()) for item in graph.initializer}
        student.load_state_dict({name: arrays[_name_of(name)] for name in student.state_dict()})
    except (OSError, KeyError, ValueError, RuntimeError, DecodeError) as error:
        raise BadFile(f"{path}: not a network of this recipe's sizes: {' '.join(str(error).split())[:160]}") from error


def _name_of(name: str) -> str:
    """Name in the ONNX file of a parameter: layers.0.weight is w0, layers.2.bias is b1."""
    if not name.startswith("layers."):
        return name
    _, layer, kind = name.split(".")
    return f"{kind[0]}{int(layer) // 2}"


def save_onnx(student: Student, path: Path, metadata: dict[str, str]) -> None:
    """Write the network with what it was made of; the same weights give the same bytes."""
    weights = {"mean": student.mean, "scale": student.scale}
    nodes = [
        helper.make_node("Sub", ["observation", "mean"], ["centred"]),
        helper.make_node("Mul", ["centred", "scale"], ["scaled"]),
        helper.make_node("Clip", ["scaled", "low", "high"], ["x0"]),
    ]
    linears = [layer for layer in student.layers if isinstance(layer, torch.nn.Linear)]
    for number, layer in enumerate(linears):
        weights |= {f"w{number}": layer.weight, f"b{number}": layer.bias}
        is_last = number == len(linears) - 1
        out = "action" if is_last else f"y{number}"
        nodes.append(helper.make_node("Gemm", [f"x{number}", f"w{number}", f"b{number}"], [out], transB=1))
        if not is_last:
            nodes.append(helper.make_node("Elu", [out], [f"x{number + 1}"]))
    arrays = {name: value.detach().cpu().numpy() for name, value in weights.items()}
    arrays |= {"low": np.float32(-8.0), "high": np.float32(8.0)}
    graph = helper.make_graph(
        nodes,
        "policy",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["batch", linears[0].in_features])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["batch", linears[-1].out_features])],
        [numpy_helper.from_array(np.asarray(array), name) for name, array in arrays.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", _OPSET)], ir_version=8)
    for key, value in metadata.items():
        entry = model.metadata_props.add()
        entry.key, entry.value = key, value
    onnx.checker.check_model(model)
    path.write_bytes(model.SerializeToString())
