"""Finding the model of the robot that an episode or a live station names."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from station import assets
from station.errors import StationError
from station.life.rig import DEFAULT_ROBOT_MODEL
from station.view.model import RobotModel


def find_model(
    servers: Iterable[Mapping[str, Any]], robot: str, reference: str | Path | None = None
) -> tuple[RobotModel | None, list[str]]:
    """Return the robot's model, or None, and what there is to say about it.

    Args:
        servers: What the servers stated.
        robot: Suffix of the robot; "" for any.
        reference: A model that the user names; it must be there.

    Raises:
        AssetMissing, BadFile: the model that the user named is not there, or is none.
    """
    if reference is not None:
        return RobotModel(assets.resolve(str(reference))), []
    facts: Mapping[str, Any] = next(
        (f["robot_facts"] for f in servers if f.get("robot") == robot and "robot_facts" in f), {}
    )
    stated = str(facts.get("model") or "")
    problems = []
    for candidate in dict.fromkeys((stated, DEFAULT_ROBOT_MODEL)):
        if not candidate:
            continue
        try:
            model = RobotModel(assets.resolve(candidate))
        except StationError as error:
            problems.append(str(error))
            continue
        return model, _doubts(model.path, stated, facts)
    return None, [f"the robot is not drawn: {problems[-1]}"]


def _doubts(path: Path, stated: str, facts: Mapping[str, Any]) -> list[str]:
    recorded = str(facts.get("model_sha256") or "")
    if recorded and assets.sha256(path) != recorded:
        return [f"the robot is drawn as {path}, which is not the model that ran ({stated}, sha256 {recorded[:12]}…)"]
    return []
