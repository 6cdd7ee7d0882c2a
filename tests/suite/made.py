"""Policies made for tests: real networks that no robot can stand on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from adapters.policies.tracker.policy import ACTIONS, OBSERVATION
from station.control.rig import RigConfig

TRACKER = RigConfig(
    policy="tracker",
    checkpoint="builtin:tracker.onnx",
    robot_options={"model": "builtin:g1.xml", "physics_dt_s": 0.002},
)


def limp_network(path: Path) -> Path:
    """Write a network for the tracker that holds the default pose whatever it sees: the robot falls in two seconds."""
    weights = numpy_helper.from_array(np.zeros((OBSERVATION, ACTIONS), dtype=np.float32), "weights")
    graph = helper.make_graph(
        [helper.make_node("Gemm", ["seen", "weights", "action"], ["out"])],
        "limp",
        [helper.make_tensor_value_info("seen", TensorProto.FLOAT, ["batch", OBSERVATION])],
        [helper.make_tensor_value_info("out", TensorProto.FLOAT, ["batch", ACTIONS])],
        [weights, numpy_helper.from_array(np.zeros(ACTIONS, dtype=np.float32), "action")],
    )
    model = helper.make_model(graph, ir_version=8, opset_imports=[helper.make_opsetid("", 17)])
    onnx.checker.check_model(model)
    path.write_bytes(model.SerializeToString())
    return path
