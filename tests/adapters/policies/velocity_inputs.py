"""What policies that follow a velocity are fed in tests, and small networks in the place of theirs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from station.protocols import Floats, RobotState
from station.rotations import normalized


def inputs(count: int, joints: int, seed: int = 0) -> list[tuple[RobotState, Floats]]:
    """Return states of some joints and velocities, shape (3,), drawn at random."""
    random = np.random.default_rng(seed)

    def state() -> RobotState:
        return RobotState(
            mono_ns=0, q=random.normal(size=joints), dq=random.normal(size=joints) * 3.0,
            quat_wxyz=normalized(np.array([1.0, 0, 0, 0]) + random.normal(size=4) * 0.4), gyro=random.normal(size=3),
            root_lin_vel=random.normal(size=3),
        )  # fmt: skip

    return [(state(), random.uniform(-1.0, 1.0, size=3)) for _ in range(count)]


def gravity(quat_wxyz: Floats) -> Floats:
    """The world's down in the frame of a body, by the matrix of its rotation."""
    w, x, y, z = quat_wxyz
    matrix = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return matrix.T @ np.array([0.0, 0.0, -1.0])


def onnx_file(
    path: Path, inputs: int, outputs: int, metadata: Mapping[str, str] | None = None, *, scale: float = 0.1
) -> Path:
    """Write a linear network of those sizes, with metadata; of scale 0 it holds the default pose, whatever it sees."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    weights = np.random.default_rng(inputs).normal(size=(inputs, outputs)).astype(np.float32) * np.float32(scale)
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["obs", "weights"], ["action"])], "policy",
        [helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, inputs])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, [1, outputs])],
        [numpy_helper.from_array(weights, "weights")],
    )  # fmt: skip
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    helper.set_model_props(model, dict(metadata or {}))
    onnx.save(model, str(path))
    return path


def script(path: Path, inputs: int, outputs: int) -> Path:
    """Write a linear network of those sizes as TorchScript."""
    import torch

    torch.manual_seed(0)
    torch.jit.save(torch.jit.script(torch.nn.Linear(inputs, outputs)), str(path))
    return path
