"""Everything that decides what the buffer is, but for the episodes; and which array holds what."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import msgspec

from adapters.exports.lerobot import plan as lerobot
from adapters.exports.lerobot.plan import Camera

Store = Literal["folder", "zip"]

STATE, ACTION, TIME = "state", "action", "time_ns"
DATA, ENDS = "data", "meta/episode_ends"


class Plan(msgspec.Struct, frozen=True, kw_only=True):
    """What all episodes have in common.

    Attributes:
        store: A folder with a file per chunk, or all of them in one zip file.
        rows: What a row is; the same as in a LeRobot data set of the same options.
    """

    store: Store
    rows: lerobot.Plan


def picture_name(camera: Camera) -> str:
    """Return the name of a camera's array: the camera's, but for those that other arrays have."""
    name = camera.name.replace("/", "_")
    return f"{name}_image" if name in (STATE, ACTION, TIME) else name


def described(plan: Plan) -> Iterator[str]:
    """Yield a line for each array."""
    common = plan.rows.common
    for name, keys in ((STATE, common.state), (ACTION, common.action)):
        yield f"{DATA}/{name}: float32; " + "; ".join(f"{one.key}, {one}" for one in keys)
    for camera in common.cameras:
        yield f"{DATA}/{picture_name(camera)}: {camera.key}, {camera.width}x{camera.height}, pixels, uint8 RGB"
    for camera in common.depths:
        what = f"depth, uint16, {camera.step_m:g} m, 0 for none"
        yield f"{DATA}/{picture_name(camera)}: {camera.key}, {camera.width}x{camera.height}, {what}"
    yield f"{DATA}/{TIME}: the instant of a row [ns since the epoch]; {plan.rows.fps} rows per second, trim " + (
        plan.rows.trim
    )
    yield f"{ENDS}: number of the first row behind each episode"
