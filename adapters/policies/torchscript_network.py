"""A TorchScript network of known sizes, run on one thread; with an LSTM, whose state is part of its input.

TorchScript can run code of its author's choosing: load only files you trust. Needs the extra ``torch``.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from station.errors import BadFile, StationError
from station.protocols import Floats32


class TorchScriptNetwork:
    """One float32 input (1, inputs), one output (1, outputs).

    Args:
        path: The file.
        inputs, outputs: Sizes that the caller needs.

    Raises:
        StationError: torch is not installed.
        BadFile: missing, not TorchScript, or of other sizes.
    """

    def __init__(self, path: Path, *, inputs: int, outputs: int) -> None:
        self._torch = _import_torch(path)
        self._outputs = outputs
        self._module = _load(self._torch, path)
        try:
            for _ in range(3):  # the profiling executor optimises during its first runs
                came = tuple(self._forward(np.zeros(inputs, dtype=np.float32)).shape)
        except (RuntimeError, AttributeError, self._torch.jit.Error) as error:
            raise BadFile(
                f"{path}: expected an input of (1, {inputs}), the network refuses it: "
                f"{str(error).strip().splitlines()[-1][:160]}"
            ) from error
        if came != (1, outputs):
            raise BadFile(f"{path}: expected an output of (1, {outputs}), the network gives {came}")

    @property
    def runtime(self) -> str:
        """What runs it, with version."""
        return f"torch {self._torch.__version__} CPU, 1 thread"

    def __call__(self, row: Floats32) -> Floats32:
        """Return the output, shape (outputs,), of one input, shape (inputs,)."""
        result: Floats32 = self._forward(row).numpy().reshape(self._outputs).copy()
        return result

    def _forward(self, row: Floats32) -> Any:
        with self._torch.inference_mode():
            return self._module(self._torch.from_numpy(row[None, :]))


class LstmNetwork(TorchScriptNetwork):
    """A module that keeps the state of its LSTM in two buffers, and changes it with every call.

    Here each call begins from the state that stands behind the inputs, shape (inputs + 2 x units,): what it gives then
    depends on its input alone, in an audit, in a hand-over and in the first call.

    Args:
        path: The file.
        inputs, outputs: Sizes that the caller needs, without the state.
        units: Of the LSTM; its hidden state, then its cell state.
    """

    def __init__(self, path: Path, *, inputs: int, outputs: int, units: int) -> None:
        super().__init__(path, inputs=inputs, outputs=outputs)
        self._inputs, buffers = inputs, dict(self._module.named_buffers())
        sizes = {name: tuple(buffers[name].shape) for name in ("hidden_state", "cell_state") if name in buffers}
        if sizes != dict.fromkeys(("hidden_state", "cell_state"), (1, 1, units)):
            raise BadFile(
                f"{path}: expected an LSTM whose state stands in hidden_state and cell_state (1, 1, {units}), "
                f"the network has {sizes or 'none'}"
            )
        self._buffers = [buffers[name] for name in sizes]

    @property
    def state(self) -> Floats32:
        """Hidden state and cell state after the newest call, shape (2 x units,)."""
        parts = [buffer.numpy().reshape(-1) for buffer in self._buffers]
        return np.concatenate(parts)

    def __call__(self, row: Floats32) -> Floats32:
        """Return the output, shape (outputs,), of one input with the state before it."""
        with self._torch.inference_mode():
            for buffer, part in zip(self._buffers, np.split(row[self._inputs :], 2), strict=True):
                buffer.copy_(self._torch.from_numpy(part).reshape(buffer.shape))
        return super().__call__(row[: self._inputs])


def _import_torch(path: Path) -> Any:
    try:
        import torch  # an optional dependency of half a gigabyte
    except ImportError as error:
        raise StationError(
            f"{path}: a TorchScript policy needs torch, which is not installed; pip install 'teleop-station[torch]'"
        ) from error
    return torch


def _load(torch: Any, path: Path) -> Any:
    if not path.is_file():
        raise BadFile(f"{path}: no such file; expected a TorchScript checkpoint")
    torch.set_num_threads(1)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # TorchScript is what upstream ships
            return torch.jit.load(str(path), map_location="cpu").eval()
    except (RuntimeError, ValueError) as error:
        raise BadFile(f"{path}: not a TorchScript checkpoint: {str(error).strip().splitlines()[0][:160]}") from error
