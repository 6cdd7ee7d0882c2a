"""A teacher's network, on many observations at once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import onnxruntime
from google.protobuf.message import DecodeError

from station.errors import BadFile
from station.protocols import Floats, Floats32


class Network:
    """An ONNX network for one observation, run for many at once.

    Args:
        path: Its file.
        threads: Threads that it may use.

    Raises:
        BadFile: missing, or no ONNX network.
    """

    def __init__(self, path: Path, threads: int) -> None:
        try:
            model = onnx.load(path)
        except (OSError, DecodeError) as error:
            raise BadFile(f"{path}: expected a teacher's ONNX network: {' '.join(str(error).split())[:160]}") from None
        del model.graph.value_info[:]  # sizes of what lies between, for one
        for value in (*model.graph.input, *model.graph.output):
            batch = value.type.tensor_type.shape.dim[0]
            batch.Clear()
            batch.dim_param = "n"
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        self._session = onnxruntime.InferenceSession(
            model.SerializeToString(), options, providers=["CPUExecutionProvider"]
        )
        self._input = self._session.get_inputs()[0].name

    def __call__(self, observations: Floats | Floats32) -> Floats32:
        """Return raw outputs, shape (n, outputs), of observations, shape (n, inputs)."""
        (outputs,) = self._session.run(None, {self._input: observations.astype(np.float32)})
        return np.asarray(outputs, dtype=np.float32)
