"""The audit of an episode in four numbers, of all its robots, for a verdict."""

from __future__ import annotations

from station.episode.reading import steps
from station.episode.reading.reader import EpisodeReader
from station.episode.replaying.arm_audit import audit_arm, is_arm
from station.episode.replaying.audit import Audit, audit
from station.episode.replaying.comparison import Comparison
from station.episode.storage.manifest_parts import AuditFound
from station.errors import StationError


def audit_in_short(reader: EpisodeReader) -> AuditFound:
    """Audit every robot of an episode; one that cannot be is said in a line, and is no difference."""
    found = AuditFound()
    for robot in steps.robots(reader.topics()):
        try:
            _add(reader, robot, found)
        except StationError as error:
            found.not_audited.append(f"{robot}: {error}")
    return found


def _other_runtime(found: Audit) -> str:
    """Return in words that the network runs on something else here, which gives other last bits; or ""."""
    pairs = ((each.recorded_runtime, each.runtime) for each in (found, *found.took_over))
    words = (
        f"recorded on {recorded}, here is {here}: last bits differ"
        for recorded, here in pairs
        if recorded and recorded != here
    )
    return next(words, "")


def _add(reader: EpisodeReader, robot: str, found: AuditFound) -> None:
    if is_arm(reader, robot):
        arm = audit_arm(reader, robot)
        compared: tuple[Comparison, ...] = (arm.commands, arm.targets)
        found.different += arm.states_different
        found.not_proven += arm.incomplete
    else:
        policy = audit(reader, robot=robot)
        compared = (policy.commands, policy.targets)
        found.different += policy.gates_different
        if (why := _other_runtime(policy)) and policy.different + policy.observations.different:
            found.not_audited.append(f"{robot}: actions and observations: {why}")
        else:
            compared = (*compared, policy.observations)
            found.compared += policy.steps
            found.different += policy.different
        reasons = (policy.commands_not_proven, policy.targets_not_proven)
        found.not_proven += policy.incomplete + policy.past_unknown + sum(sum(why.values()) for why in reasons)
    found.compared += sum(one.compared for one in compared)
    found.different += sum(one.different for one in compared)
