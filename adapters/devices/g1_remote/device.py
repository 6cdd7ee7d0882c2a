"""Sticks and buttons of a G1's remote, by the names of a gamepad's. Needs the extra ``g1``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from adapters.devices.gamepad.names import CONTROLS, apply_dead_band
from adapters.robots.g1.dds import messages, topics, types
from adapters.robots.g1.dds.network import Network
from adapters.robots.g1.dds.options import NetworkOptions
from adapters.robots.g1.dds.remote import Remote
from station.errors import ConfigError
from station.operator.device import DeviceError
from station.operator.sample import OperatorSample

NAMES: Mapping[str, str] = {
    "A": "right_primary", "B": "right_secondary", "X": "left_primary", "Y": "left_secondary", "L1": "left_bumper",
    "R1": "right_bumper", "L2": "left_trigger", "R2": "right_trigger", "start": "start", "F1": "left_stick_click",
    "F2": "right_stick_click", "up": "dpad_up", "down": "dpad_down", "left": "dpad_left", "right": "dpad_right",
    "select": "back",
}  # fmt: skip
"""What each button is called: as the one in its place on a gamepad."""


class States(Protocol):
    """Where states come from: a reader of a robot's network, or a fake."""

    def take(self) -> list[bytes]:
        """Return the messages since the last call."""
        ...


class G1Remote:
    """Reads the newest state of the robot at each look.

    Args:
        options: Where the robot is.
        dead_band: Part of full deflection within which a stick counts as at rest.
        states: Those of a fake; None for the robot's.

    Raises:
        DeviceError: there is no such network interface.
    """

    def __init__(self, options: NetworkOptions, dead_band: float, states: States | None = None) -> None:
        self._options, self._dead_band = options, dead_band
        self._network: Network | None = None
        if states is None:
            try:
                self._network = Network(options)
            except ConfigError as error:
                raise DeviceError(str(error)) from None
            states = self._network.reader(topics.LOW_STATE, types.LowState, depth=1)
        self._states = states
        self._remote = Remote()
        self._is_heard = False

    def read(self) -> OperatorSample | None:
        """Return sticks and buttons; None if the robot sent no state since the last call, or if its remote is off."""
        records = messages.intact_states(self._states.take())
        if not len(records):
            return None
        self._is_heard = True
        self._remote.update(np.ascontiguousarray(records["remote"]))
        if not self._remote.is_on:
            return None
        shown = dict.fromkeys(CONTROLS, 0.0) | {NAMES[name]: 1.0 for name in self._remote.held if name in NAMES}
        sticks = self._remote.sticks
        for side, x, y in (("left", sticks.left_x, sticks.left_y), ("right", sticks.right_x, sticks.right_y)):
            shown[f"{side}_stick_x"], shown[f"{side}_stick_y"] = (
                float(np.clip(np.nan_to_num(v), -1, 1)) for v in (x, y)
            )
        apply_dead_band(shown, self._dead_band)
        return OperatorSample(controls=shown)

    def why_silent(self) -> str:
        """Return why there is no sample: the robot is not heard, or its remote is off."""
        where = f"{self._options.interface}, domain {self._options.domain}"
        if self._is_heard and not self._remote.is_on:
            return "the robot is heard and its remote is off; switch it on"
        return f"no state of a G1 on {where}: is it switched on, is its cable in this interface?"

    def facts(self) -> dict[str, Any]:
        """Return where it is heard."""
        return {
            "device": "g1-remote", "interface": self._options.interface, "domain": self._options.domain,
            "dead_band": self._dead_band,
        }  # fmt: skip

    def close(self) -> None:
        """Leave the network."""
        if self._network is not None:
            self._network.close()
