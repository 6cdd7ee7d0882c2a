"""A small network in the place of unitree_rl_gym's; imported where it is made, since torch takes two seconds."""

from __future__ import annotations

from pathlib import Path

import torch


class Remembering(torch.nn.Module):  # type: ignore[misc]
    """What upstream exports: an LSTM that keeps its state in two buffers, and a layer."""

    def __init__(self, inputs: int, actions: int, units: int = 64) -> None:
        super().__init__()
        torch.manual_seed(inputs)
        self.memory, self.actor = torch.nn.LSTM(inputs, units), torch.nn.Linear(units, actions)
        self.register_buffer("hidden_state", torch.zeros(1, 1, units))
        self.register_buffer("cell_state", torch.zeros(1, 1, units))

    def forward(self, x):
        out, (hidden, cell) = self.memory(x.unsqueeze(0), (self.hidden_state, self.cell_state))
        self.hidden_state[:] = hidden
        self.cell_state[:] = cell
        return self.actor(out.squeeze(0))


def write(path: Path, inputs: int, actions: int, units: int) -> Path:
    """Write one of those sizes as TorchScript."""
    module = Remembering(inputs, actions, units).eval()
    torch.jit.save(torch.jit.script(module), str(path))
    return path
