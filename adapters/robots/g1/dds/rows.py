"""What a G1 measures between two control steps, as numbers with names: every state that it sent."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from adapters.robots.g1.joints import G1_29
from station.contract import Element, elements
from station.description import JOINT

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_JOINT_COLUMNS = (
    ("pos", "rad"), ("vel", "rad/s"), ("acc", "rad/s^2"), ("torque", "N m"), ("casing", "degC"), ("winding", "degC"),
    ("voltage", "V"), ("error", ""),
)  # fmt: skip

SAMPLES: tuple[Element, ...] = (
    *elements((("tick",), "ms"), (("mode_machine",), "")),
    *(element for name, unit in _JOINT_COLUMNS for element in elements(((f"{JOINT}_{name}",), unit))),
    *elements(
        (("quat_w", "quat_x", "quat_y", "quat_z"), ""),
        (("gyro_x", "gyro_y", "gyro_z"), "rad/s"),
        (("acc_x", "acc_y", "acc_z"), "m/s^2"),
        (("imu_temperature",), "degC"),
        (("remote_buttons", "remote_left_x", "remote_left_y", "remote_right_x", "remote_right_y"), ""),
    ),
)
"""Of each state; the pelvis' IMU, its quaternion in a world whose yaw is where the robot was switched on."""

_JOINTS = len(G1_29)
_REMOTE = 6  # numbers behind those of the IMU, with its temperature
Q, DQ = slice(2, 2 + _JOINTS), slice(2 + _JOINTS, 2 + 2 * _JOINTS)
INERTIAL = slice(2 + len(_JOINT_COLUMNS) * _JOINTS, 12 + len(_JOINT_COLUMNS) * _JOINTS)
"""Where in a row of `SAMPLES` the joints' positions and velocities are, and quaternion, gyro, accelerometer."""

BATTERY: tuple[Element, ...] = elements(
    (("soc", "soh"), "%"), (("pack_voltage",), "V"), (("current",), "A"), (("temperature_max",), "degC")
)
"""As `messages.battery` returns them."""


def of(records: NDArray[Any]) -> NDArray[np.float64]:
    """Return states, records of `messages.STATE`, shape (k,), as rows of `SAMPLES`, shape (k, m)."""
    import numpy as np

    rows = np.empty((len(records), INERTIAL.stop + _REMOTE))
    rows[:, 0], rows[:, 1] = records["tick"], records["mode_machine"]
    motors = records["motors"][:, :_JOINTS]
    joints = rows[:, Q.start : INERTIAL.start].reshape(len(records), len(_JOINT_COLUMNS), _JOINTS)
    joints[:, :4] = motors["motion"].swapaxes(1, 2)
    joints[:, 4:6] = motors["temperature"].swapaxes(1, 2)
    joints[:, 6], joints[:, 7] = motors["voltage"], motors["error"]
    rows[:, INERTIAL] = records["inertial"]
    remote = np.ascontiguousarray(records["remote"])
    rest = rows[:, INERTIAL.stop :]
    rest[:, 0] = records["imu_temperature"]
    rest[:, 1] = remote[:, 2:4].view("<u2")[:, 0]
    rest[:, 2:] = remote.view("<f4")[:, (1, 5, 2, 3)]
    return rows
