"""A feed-forward ONNX network of known sizes, run on one thread."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import onnxruntime

from station.errors import BadFile
from station.protocols import Floats32


class OnnxNetwork:
    """One float32 input [batch, inputs], one output [batch, outputs]; of several those that are named.

    One thread and no spinning: the default pool burns a core between the steps of a 50 Hz loop and is slower at its
    99th percentile as soon as other work needs the machine.

    Args:
        path: The ``.onnx`` file.
        inputs, outputs: Sizes that the caller needs.
        named: Names of that input and that output where the network may have others; None where it has one of each.
        beside: Further inputs by name, which are always the same.

    Raises:
        BadFile: missing, not ONNX, or of other sizes.
    """

    def __init__(
        self,
        path: Path,
        *,
        inputs: int,
        outputs: int,
        named: tuple[str, str] | None = None,
        beside: Mapping[str, Floats32] | None = None,
    ) -> None:
        self._session = open_session(path)
        wanted_input, wanted_output = named or ("", "")
        self._beside = dict(beside or {})
        given = [port for port in self._session.get_inputs() if port.name not in self._beside]
        self._input = _only(path, "input", given, inputs, wanted_input)
        self._output = _only(path, "output", self._session.get_outputs(), outputs, wanted_output)
        self._outputs = outputs
        self(np.zeros(inputs, dtype=np.float32))  # the first run allocates; better now than in the first step

    @property
    def runtime(self) -> str:
        """What runs it, with version."""
        return f"onnxruntime {onnxruntime.__version__} CPU, 1 thread"

    @property
    def metadata(self) -> dict[str, str]:
        """What whoever exported it wrote into the file."""
        return dict(self._session.get_modelmeta().custom_metadata_map)

    def __call__(self, row: Floats32) -> Floats32:
        """Return the output, shape (outputs,), of one input, shape (inputs,)."""
        (batch,) = self._session.run([self._output], {self._input: row[None, :], **self._beside})
        result: Floats32 = batch.reshape(self._outputs)
        return result


def open_session(path: Path) -> onnxruntime.InferenceSession:
    """Return a network that runs on one thread and does not spin.

    Raises:
        BadFile: missing, or not ONNX.
    """
    if not path.is_file():
        raise BadFile(f"{path}: no such file; expected an ONNX checkpoint")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 3
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    # onnxruntime's errors share no base but Exception, and each means the same to the user.
    except Exception as error:
        reason = " ".join(str(error).split())
        raise BadFile(f"{path}: not a usable ONNX checkpoint: {reason[:160]}") from error


def _only(path: Path, kind: str, ports: list[onnxruntime.NodeArg], size: int, name: str) -> str:
    came = ", ".join(f"{port.name} [{', '.join(map(str, port.shape))}] {port.type}" for port in ports)
    ports = [port for port in ports if name in ("", port.name)]
    if len(ports) != 1 or len(ports[0].shape) != 2 or ports[0].shape[1] != size or ports[0].type != "tensor(float)":
        wanted = f"{kind} {name}".rstrip()
        raise BadFile(f"{path}: expected one float {wanted} [batch, {size}], the checkpoint has {came}")
    return str(ports[0].name)
