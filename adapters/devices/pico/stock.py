"""What stock TWIST2 expects of the controllers on the bus."""

from __future__ import annotations

from typing import Any

from station.operator.sample import OperatorSample, Side


def controller_data(reading: OperatorSample) -> dict[str, Any]:
    """Return a sample as stock TWIST2 teleoperation writes it; the time stamp is the headset's [ns].

    Source: amazon-far/TWIST2, ``deploy_real/xrobot_teleop_to_robot_w_hand.py``; its recorder fails where a key lacks.
    """
    return {
        "LeftController": _controller("left", reading),
        "RightController": _controller("right", reading),
        "timestamp": reading.capture_ns or 0,
    }


def _controller(side: Side, reading: OperatorSample) -> dict[str, Any]:
    def value(name: str) -> float:
        return reading.controls.get(f"{side}_{name}", 0.0)

    return {
        "index_trig": value("trigger"),
        "grip": value("grip"),
        "key_one": value("primary") > 0.5,
        "key_two": value("secondary") > 0.5,
        "axis": [value("stick_x"), value("stick_y")],
        "axis_click": value("stick_click") > 0.5,
    }
