"""What the guard of a G1 refuses and clamps by, as a C header: from the joint table, and gains by kind of motor.

Run: ``python -m adapters.robots.g1.dds.guard_limits > bridges/g1_guard/src/limits.h``.
"""

from __future__ import annotations

import sys

from adapters.robots.g1.joints import JOINTS

# Above what policies for the real robot use, below ten times it. [N m/rad], [N m s/rad]; the first that fits counts.
_MOST_GAINS = (
    ("hip", 200.0, 10.0),
    ("knee", 300.0, 10.0),
    ("ankle", 100.0, 10.0),
    ("waist", 300.0, 10.0),
    ("wrist_pitch", 60.0, 10.0),  # the weakest motors, 5 N m
    ("wrist_yaw", 60.0, 10.0),
    ("", 120.0, 10.0),
)


def most_gains(joint: str) -> tuple[float, float]:
    """Return the greatest kp [N m/rad] and kd [N m s/rad] that the guard lets through for a joint."""
    return next((kp, kd) for part, kp, kd in _MOST_GAINS if part in joint)


def header() -> str:
    """Return the text of ``limits.h``."""
    rows = "".join(
        f"    {{{', '.join(f'{value}f' for value in (joint.lower, joint.upper, joint.velocity_rad_s, kp, kd))}}},"
        f"  // {joint.name}\n"
        for joint in JOINTS
        for kp, kd in [most_gains(joint.name)]
    )
    return (
        "// Made by `python -m adapters.robots.g1.dds.guard_limits`; do not edit.\n"
        "#ifndef G1_GUARD_LIMITS_H\n#define G1_GUARD_LIMITS_H\n\n"
        "static const struct joint_limits {\n"
        "    float lower_rad, upper_rad, speed_rad_s, kp_max, kd_max;\n"
        f"}} JOINT_LIMITS[{len(JOINTS)}] = {{\n{rows}}};\n\n#endif\n"
    )


if __name__ == "__main__":
    sys.stdout.write(header())
