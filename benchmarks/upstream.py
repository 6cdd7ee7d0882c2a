"""What stock TWIST2 runs: its checkpoint, its meshed G1, one of its motions.

Every figure that stands beside the stock pattern is taken with these, so that both do the same work, and so that it can
be compared with earlier ones: what the station runs by itself is lighter.
"""

from __future__ import annotations

from station import assets
from station.control.rig import RigConfig
from station.errors import StationError

CHECKPOINT = "twist2:ckpts/twist2_1017_20k.onnx"
ROBOT_MODEL = "twist2:g1/g1_sim2sim_29dof.xml"
MOTION = "twist2:motions/0807_yanjie_walk_001.pkl"

RIG = RigConfig(policy="twist2", checkpoint=CHECKPOINT, robot_options={"model": ROBOT_MODEL})
G1_SETTINGS = ("policy=twist2", f"checkpoint={CHECKPOINT}", f"robot_model={ROBOT_MODEL}")
"""The same for ``station serve g1 --set``."""


def settings(prefix: str) -> list[str]:
    """Return options that make our G1 load what stock's loads; as paths, since an empty cache may be where they were.

    Args:
        prefix: Of each setting: ``g1.`` for a runbook, "" for ``station serve g1``.
    """
    names = {"robot_model": ROBOT_MODEL, "checkpoint": CHECKPOINT}
    values = {"policy": "twist2"} | {name: str(assets.resolve(reference)) for name, reference in names.items()}
    return [word for name, value in values.items() for word in ("--set", f"{prefix}{name}={value}")]


def problem() -> str:
    """Return what is missing of it and how it comes here, in one line; "" when all is there."""
    try:
        for reference in (CHECKPOINT, ROBOT_MODEL, MOTION):
            assets.resolve(reference)
    except StationError as error:
        return str(error)
    return ""
