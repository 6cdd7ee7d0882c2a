"""What a G1 measures between two control steps, as numbers with names: every state that it sent."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from station.contract import Element, elements
from station.description import JOINT

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_JOINT_COLUMNS = (
    ("q", "pos", "rad"), ("dq", "vel", "rad/s"), ("ddq", "acc", "rad/s^2"), ("tau", "torque", "N m"),
    ("casing", "casing", "degC"), ("winding", "winding", "degC"), ("voltage", "voltage", "V"), ("error", "error", ""),
)  # fmt: skip

SAMPLES: tuple[Element, ...] = (
    *elements((("tick",), "ms"), (("mode_machine",), "")),
    *(element for _, name, unit in _JOINT_COLUMNS for element in elements(((f"{JOINT}_{name}",), unit))),
    *elements(
        (("quat_w", "quat_x", "quat_y", "quat_z"), ""),
        (("gyro_x", "gyro_y", "gyro_z"), "rad/s"),
        (("acc_x", "acc_y", "acc_z"), "m/s^2"),
        (("imu_temperature",), "degC"),
        (("remote_buttons", "remote_left_x", "remote_left_y", "remote_right_x", "remote_right_y"), ""),
    ),
)
"""Of each state; the pelvis' IMU, its quaternion in a world whose yaw is where the robot was switched on."""

BATTERY: tuple[Element, ...] = elements(
    (("soc", "soh"), "%"), (("pack_voltage",), "V"), (("current",), "A"), (("temperature_max",), "degC")
)


def of(records: NDArray[Any]) -> NDArray[np.float64]:
    """Return states, records of `messages.STATE`, shape (k,), as rows of `SAMPLES`, shape (k, m)."""
    import numpy as np

    from adapters.robots.g1.dds.health_monitor import JOINTS

    motors = records["motors"][:, :JOINTS]
    special = {"casing": motors["temperature"][..., 0], "winding": motors["temperature"][..., 1]}
    remote = np.ascontiguousarray(records["remote"])
    buttons = remote[:, 2:4].view("<u2")
    sticks = remote.view("<f4")[:, (1, 5, 2, 3)]
    columns = (
        records["tick"][:, None],
        records["mode_machine"][:, None],
        *(special[name] if name in special else motors[name] for name, _, _ in _JOINT_COLUMNS),
        records["quat_wxyz"],
        records["gyro"],
        records["accelerometer"],
        records["imu_temperature"][:, None],
        buttons,
        sticks,
    )
    return np.concatenate(columns, axis=1, dtype=np.float64)


def battery(message: Any) -> NDArray[np.float64]:
    """Return what a battery says, an object of `types.BmsState`, in the order of `BATTERY`."""
    import numpy as np

    return np.array([
        message.soc, message.soh, message.bmsvoltage[0] / 1000.0, message.current / 1000.0, max(message.temperature)
    ], dtype=np.float64)  # fmt: skip
