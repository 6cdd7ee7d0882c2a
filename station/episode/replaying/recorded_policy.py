"""The policy that an episode was recorded with: what the episode says of it, and the thing itself."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import msgspec

from station import assets, registry
from station.bus import keys
from station.control.rig import checkpoint_of
from station.episode.reading import steps
from station.episode.reading.reader import EpisodeReader
from station.errors import BadFile, EpisodeError
from station.protocols import Policy


class StatedPolicy(msgspec.Struct, frozen=True, kw_only=True):
    """The policy that an episode says it was recorded with; "" for what it does not say.

    `checkpoint` is where the file was on the machine that recorded; `reference` is how its user named it; `command` is
    the registered name of the commands that it follows.
    """

    robot: str
    name: str
    checkpoint: str
    sha256: str
    runtime: str
    options: dict[str, Any] = {}
    reference: str = ""
    command: str = ""


def recorded_policies(reader: EpisodeReader, robot: str | None = None) -> dict[str, StatedPolicy]:
    """Return the policies that an episode says it was recorded with, by the name that its steps know them by.

    Where a robot has but one, its name is "".

    Raises:
        EpisodeError: it has no policy steps, or those of several robots and none is named.
    """
    present = steps.robots(reader.topics())
    if not present:
        raise EpisodeError(
            f"episode {reader.episode_id}: no policy steps ({keys.policy_obs('*')}) to audit; "
            "was it recorded with a low-level server of this station?"
        )
    if robot is None and len(present) > 1:
        raise EpisodeError(f"episode {reader.episode_id}: several robots ({', '.join(present)}); name one")
    if robot is not None and robot not in present:
        raise EpisodeError(f"episode {reader.episode_id}: no steps of {robot!r}; it has {', '.join(present)}")
    chosen = robot or present[0]
    facts = stated_facts(reader, chosen)
    several = facts.get("policies")
    if not isinstance(several, dict) or not several:
        return {"": _of_facts(reader, chosen, facts, facts.get("policy", {}), _config(facts))}
    further = _mapping(_config(facts).get("policies"))
    return {
        str(name): _of_facts(
            reader, chosen, facts, _mapping(each), _mapping(further[name]) if name in further else _config(facts)
        )
        for name, each in several.items()
    }


def _of_facts(
    reader: EpisodeReader, robot: str, facts: dict[str, Any], stated: dict[str, Any], config: dict[str, Any]
) -> StatedPolicy:
    manifest = reader.manifest.policy
    text = {
        name: str(stated.get(name) or getattr(manifest, name))
        for name in ("name", "checkpoint", "sha256", "runtime", "command")
    }
    options = stated.get("options")
    return StatedPolicy(
        robot=robot, **text, options=options if isinstance(options, dict) else {},
        reference=_reference(facts, config, text["name"]),
    )  # fmt: skip


def load_policy(reader: EpisodeReader, suspect: StatedPolicy, checkpoint: str | Path | None = None) -> Policy:
    """Load the policy of an episode and see that its checkpoint is the one that ran.

    Raises:
        EpisodeError: the episode does not name it, or the file is another one.
        AssetMissing, BadFile: the checkpoint is not on this machine.
    """
    wanted = str(checkpoint or suspect.checkpoint)
    if not suspect.name or not wanted:
        raise EpisodeError(
            f"episode {reader.episode_id}: does not name the policy it ran "
            f"(name {suspect.name!r}, checkpoint {suspect.checkpoint!r}); it cannot be audited"
        )
    path = _find(suspect, wanted, is_given=checkpoint is not None)
    make = registry.find("policy", suspect.name)
    unknown = set(suspect.options) - set(inspect.signature(make).parameters)
    if unknown:
        raise EpisodeError(
            f"episode {reader.episode_id}: ran policy {suspect.name!r} with options that it no longer has: "
            f"{', '.join(sorted(unknown))}; audit it with the version of the policy that ran"
        )
    try:
        policy: Policy = make(path, **suspect.options)
        came = policy.spec.sha256  # of all its files: some have several
    except BadFile:
        came = assets.sha256(path)
        if came == suspect.sha256 or not suspect.sha256:
            raise
    if suspect.sha256 and came != suspect.sha256:
        raise EpisodeError(
            f"episode {reader.episode_id}: ran checkpoint sha256 {suspect.sha256[:12]}…, {path} is {came[:12]}…; "
            "name the file that ran with --checkpoint"
        )
    return policy


def _find(suspect: StatedPolicy, wanted: str, *, is_given: bool) -> Path:
    """Return the checkpoint; on another machine than the one that recorded, where its user's own name for it leads."""
    try:
        return assets.resolve(wanted)
    except BadFile:
        if is_given or not suspect.reference:
            raise
        return assets.resolve(suspect.reference)


def stated_facts(reader: EpisodeReader, robot: str) -> dict[str, Any]:
    """Return what the low-level server of a robot stated; empty when none did."""
    for facts in reader.manifest.servers.values():
        if facts.get("robot") == robot and isinstance(facts.get("policy"), dict):
            return dict(facts)
    return {}


def is_simulated(facts: dict[str, Any]) -> bool:
    """Whether a robot, by what its server stated, is a simulation that does what it is told; False where unknown."""
    named = str(_config(facts).get("robot") or facts.get("kind") or "")
    described = _mapping(facts.get("robot_facts"))
    if named in registry.names("robot"):
        return bool(registry.find("robot", named).is_simulated)
    return "physics_dt_s" in described


def _config(facts: dict[str, Any]) -> dict[str, Any]:
    return _mapping(facts.get("config"))


def _mapping(value: object) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _reference(facts: dict[str, Any], config: dict[str, Any], policy: str) -> str:
    """Return how the user named a policy's file, in the settings of the server or of that policy; "" where unknown."""
    if not _config(facts):
        return ""
    named, robot = str(config.get("checkpoint") or ""), _config(facts).get("robot")
    kind = registry.find("robot", robot) if robot in registry.names("robot") else None
    return checkpoint_of(policy, named, kind) if policy in registry.names("policy") else named
