"""Finding the model of the robot that an episode or a live station names."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from station import assets
from station.bus.contracts import Contracts
from station.errors import StationError

if TYPE_CHECKING:
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
    from station.view.model import RobotModel  # MuJoCo, which `find_path` does without

    if reference is not None:
        return RobotModel(assets.resolve(str(reference))), []
    problems: list[str] = []
    for path, doubts in _present(servers, robot, problems):
        try:
            return RobotModel(path), doubts
        except StationError as error:
            problems.append(str(error))
    return None, [f"the robot is not drawn: {problems[-1]}"]


def find_path(
    servers: Iterable[Mapping[str, Any]], robot: str, reference: str | Path | None = None
) -> tuple[Path | None, list[str]]:
    """Like `find_model`, for code that reads the file itself."""
    if reference is not None:
        return assets.resolve(str(reference)), []
    problems: list[str] = []
    for path, doubts in _present(servers, robot, problems):
        return path, doubts
    return None, [f"the robot is not drawn: {problems[-1]}"]


def _present(servers: Iterable[Mapping[str, Any]], robot: str, problems: list[str]) -> Iterator[tuple[Path, list[str]]]:
    """Yield the models that are here, the one that ran first, and what is to be said of each; the others' problems.

    Of a robot whose server says nothing of a model, the one that its description is drawn as is taken.
    """
    facts: Mapping[str, Any] = next(
        (found for f in servers if f.get("robot") == robot and isinstance(found := f.get("robot_facts"), Mapping)), {}
    )
    stated = str(facts.get("model") or "")
    known = Contracts(servers)
    described = known.robot(robot or next(iter(known.robots()), ""))
    usual = described.drawn_as if described is not None else ""
    if not (stated or usual):
        problems.append(f"nothing says which model {robot or 'the robot'} has; name one with --robot-model")
    for candidate in dict.fromkeys((stated, usual)):
        if not candidate:
            continue
        try:
            path = assets.resolve(candidate)
        except StationError as error:
            problems.append(str(error))
            continue
        yield path, _doubts(path, stated, facts)


def _doubts(path: Path, stated: str, facts: Mapping[str, Any]) -> list[str]:
    recorded = str(facts.get("model_sha256") or "")
    if recorded and assets.sha256(path) != recorded:
        return [f"the robot is drawn as {path}, which is not the model that ran ({stated}, sha256 {recorded[:12]}…)"]
    return []
