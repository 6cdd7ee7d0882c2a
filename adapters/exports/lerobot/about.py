"""What is known of an episode beside its rows: columns of ``meta/episodes`` in v3.0, keys of a line in v2.1."""

from __future__ import annotations

from typing import Any

from station.episode.storage.manifest import Manifest
from station.export.kind import Shard

FIELDS = {
    "episode_id": "string",
    "task_name": "string",
    "instruction": "string",
    "success": "string",
    "verdict": "string",
    "operator": "string",
    "interface": "string",
    "policy": "string",
    "recorded": "string",
    "marks": "int64",
    "trim_head_s": "double",
    "trim_tail_s": "double",
}
"""Types by name. Texts are never null: a column without a single value has its type all the same."""

MEANING = {
    "task_name, instruction": "of the task, as recorded; LeRobot's own `tasks` has the instruction, else the name",
    "success": "what the operator said: yes, no, or nothing",
    "verdict": "of `station check`: good, usable or reject; nothing where no check has said one of these files",
    "operator, interface": "who operated, and through what",
    "policy, recorded": "name of the policy; when the recording began",
    "marks": "how many marks the operator made",
    "trim_head_s, trim_tail_s": "rows left out at the ends [s]",
}


def said(manifest: Manifest) -> dict[str, Any]:
    """Return the fields that the manifest of an episode says."""
    success = {True: "yes", False: "no", None: ""}[manifest.quality_flags.success]
    return {
        "task_name": manifest.task.name,
        "instruction": manifest.task.instruction,
        "success": success,
        "operator": manifest.operator.id,
        "interface": manifest.operator.interface,
        "policy": manifest.policy.name,
        "recorded": manifest.timing.started,
        "marks": len(manifest.marks),
    }


def fields(shard: Shard) -> dict[str, Any]:
    """Return the fields of an episode, all of `FIELDS`."""
    facts = shard.made.facts
    trim = facts["trim"]
    found = facts | {
        "episode_id": shard.source.episode_id,
        "trim_head_s": trim["head_s"],
        "trim_tail_s": trim["tail_s"],
    }
    return {name: found[name] for name in FIELDS}
