"""How a viewer arranges an episode or a live station: robot and reference, states and events, tabs of curves."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from station.contract import Contract
from station.view import scene
from station.view.curves import CURVES, groups

TIMELINE = "episode_time"
STATES = "states"
EVENTS = "events"
JOINTS = "joints"
"""Below it one entity per joint with the curves ``commanded`` and ``measured``."""

GATE_COLOURS = {
    "waiting": 0x9E9E9EFF,
    "entering": 0x42A5F5FF,
    "tracking": 0x66BB6AFF,
    "holding": 0xFFA726FF,
    "returning": 0xAB47BCFF,
    "stopped": 0xEF5350FF,
    "faulted": 0xB71C1CFF,
}
MOTION_COLOURS = {
    "waiting": 0x9E9E9EFF,
    "entering": 0x42A5F5FF,
    "playing": 0x26A69AFF,
    "paused": 0xFFCA28FF,
    "leaving": 0xAB47BCFF,
    "done": 0x616161FF,
}
_LONGEST_LEGEND = 8


def layout(
    contracts: Iterable[Contract],
    *,
    has_robot: bool,
    groups: Mapping[str, tuple[str, ...]],
    pictures: Sequence[str] = (),
    clouds: Sequence[str] = (),
    timeline: str = TIMELINE,
) -> Any:
    """Return the blueprint.

    Args:
        contracts: Keys that have curves.
        has_robot: Whether there is a robot to look at.
        groups: Names of joints by limb, where commanded and measured ones are there to be compared; else none.
        pictures: Entities that are pictures, for a tab of their own.
        clouds: Entities with points that are not in the robot's scene, likewise.
        timeline: The timeline that is shown.
    """
    story: list[Any] = [
        rrb.StateTimelineView(origin=f"/{STATES}", name="Gate and motion"),
        rrb.TextLogView(origin=f"/{EVENTS}", name="Events"),
    ]
    shares = [2.0, 1.5]
    if has_robot:
        eye = rrb.EyeControls3D(tracking_entity=f"/{scene.ROBOT}")
        story.insert(0, rrb.Spatial3DView(origin=f"/{scene.WORLD}", name="Robot and reference", eye_controls=eye))
        shares.insert(0, 6.0)
    tabs = _tabs(list(contracts), groups)
    if pictures:
        tabs.append(
            rrb.Grid(*(rrb.Spatial2DView(origin=f"/{entity}", name=entity) for entity in pictures), name="Depth")
        )
    if clouds:
        tabs.append(
            rrb.Grid(*(rrb.Spatial3DView(origin=f"/{entity}", name=entity) for entity in clouds), name="Clouds")
        )
    left = rrb.Vertical(*story, row_shares=shares)
    body = rrb.Horizontal(left, rrb.Tabs(*tabs), column_shares=[1, 1]) if tabs else left
    return rrb.Blueprint(body, rrb.TimePanel(timeline=timeline), collapse_panels=True)


def log_state_colours(recording: rr.RecordingStream) -> None:
    """Give the states of the gate and the phases of the motion their colours."""
    for name, colours in (("gate", GATE_COLOURS), ("motion", MOTION_COLOURS)):
        states = list(colours)
        configuration = rr.StateConfiguration(values=states, labels=states, colors=list(colours.values()))
        recording.log(f"{STATES}/{name}", configuration, static=True)


def _tabs(contracts: list[Contract], limbs: Mapping[str, tuple[str, ...]]) -> list[Any]:
    tabs = []
    if limbs:
        plots = [
            _plot("/", name, contents=[f"/{JOINTS}/{joint}/**" for joint in limb], lines=2 * len(limb))
            for name, limb in limbs.items()
        ]
        tabs.append(rrb.Grid(*plots, name="Commanded and measured"))
    for role in ("command", "state", "policy", "sensor"):
        plots = [
            _plot(f"/{CURVES}/{role}/{item.key}/{quantity}", f"{item.key}: {quantity}", lines=len(indices))
            for item in contracts
            if item.role == role
            for quantity, indices in groups(item.elements).items()
        ]
        if plots:
            tabs.append(rrb.Grid(*plots, name=role.capitalize()))
    tabs.append(_plot(f"/{CURVES}/latency", "Latency", lines=0))
    return tabs


def _plot(origin: str, name: str, *, lines: int, contents: Any = "$origin/**") -> Any:
    # A legend of thirty names covers the curves; the name of a curve also shows under the pointer.
    legend = rrb.PlotLegend(visible=lines <= _LONGEST_LEGEND)
    return rrb.TimeSeriesView(origin=origin, contents=contents, name=name, plot_legend=legend)
