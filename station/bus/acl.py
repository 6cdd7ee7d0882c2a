"""Who may do what on a shared bus: one user per role, as the access control list that Redis 7 and Valkey read.

A command server cannot say where the robot is, a low-level server cannot give commands, a recorder reads everything
and writes nothing but its own bookkeeping, an observer says only how it is doing, a viewer says nothing at all. A
console asks and answers for the people who look at it, and commands nothing. Everybody may press the emergency stop,
on a key whose every write stops; only an operator and a console write the key that releases it. No role may change the
server's settings, run scripts or delete the keys of others. The default user, whom a stranger is, is off.
"""

from __future__ import annotations

import hashlib
import secrets
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from functools import cache

from station.bus import keys

_ANY = "*"
_READ = (
    "+ping +select +hello +reset +client|setname +client|setinfo +acl|whoami +time +info +config|get "
    "+get +mget +exists +type +strlen +ttl +pttl +scan +dbsize "
    "+subscribe +psubscribe +unsubscribe +punsubscribe"
)
_WRITE = "+set +mset"
_COMMANDS = (keys.action(_ANY), keys.command_source(_ANY))
_STATES = (
    keys.state(_ANY), keys.robot_state(_ANY), keys.policy_obs(_ANY), keys.policy_action(_ANY),
    keys.policy_timing(_ANY), keys.target(_ANY), keys.sim_qpos(_ANY), keys.root_velocity(_ANY),
    keys.command_gate(_ANY), keys.command_used(_ANY), keys.command_timing(_ANY),
)  # fmt: skip
_OPERATOR = (
    keys.operator_status(_ANY), keys.operator_controls(_ANY), keys.operator_head(_ANY), keys.operator_left(_ANY),
    keys.operator_right(_ANY), keys.operator_body_pos(_ANY), keys.operator_body_quat(_ANY),
    keys.operator_hand_left(_ANY), keys.operator_hand_right(_ANY), keys.operator_twist(_ANY),
    keys.operator_joints(_ANY),
)  # fmt: skip
_SENSORS = (keys.camera_image(_ANY), keys.camera_depth(_ANY), keys.lidar_cloud(_ANY), keys.lidar_imu(_ANY))
_BUTTONS = (keys.ARM, keys.RECORD)  # of a device that commands
_ASKED = (keys.ARM, keys.RECORD, keys.MOTION_CONTROL, keys.RUNBOOK_ANSWER)  # of a person, who looks at the robot
_SERVERS = ("command", "low-level", "recorder", "sensor", "observer", "console")
_RELEASES = ("operator", "console")

ROLES = (*_SERVERS, "viewer", "operator")


def stop_key(user: str | None) -> str:
    """Return the key on which a user presses the stop: of those of this list who may not release one, the other."""
    return keys.ESTOP_PRESSED if user in ROLES and user not in _RELEASES else keys.ESTOP


def writes(servers: Mapping[str, Collection[str]] | None = None) -> dict[str, tuple[str, ...]]:
    """Return patterns of the keys that each role may write, stamps and the press of a stop left out.

    Args:
        servers: Names of the servers by role, whose health and configuration only that role may write; None lets each
            role write those of any server.
    """
    found = dict(_of_robots())
    for role in _SERVERS:
        names = [_ANY] if servers is None else servers.get(role, ())
        found[role] += tuple(key for name in names for key in (keys.server(name), keys.server_config(name)))
        found[role] += (keys.clock(_ANY),)
    return found


@cache
def _of_robots() -> dict[str, tuple[str, ...]]:
    """Return what each role may write but for the stop that all may press, and for what servers say of themselves.

    Keys of stock programs that bear no robot's name are those of the families of robots that are registered; signals of
    a robot's remote are reset by the server that plays a motion.
    """
    from station.bus import contracts  # here, so that a button starts at once
    from station.description import ROBOT

    shared: dict[str, list[str]] = defaultdict(list)
    for name in contracts.robots():
        robot = contracts.description(name)
        for stream in robot.streams if robot is not None else ():
            if ROBOT not in stream.key and stream.key not in shared[stream.role]:
                shared[stream.role].append(stream.key)
    commands, signals = (*_COMMANDS, *shared["command"], *shared["sensor"]), shared["control"]
    return {
        "command": (*commands, *signals, *_BUTTONS, keys.EVENT),
        "low-level": (*_STATES, *shared["state"], *signals, keys.EVENT),
        "recorder": (keys.RECORDER, keys.RECORD_ACK, keys.TAP_PROBE, keys.EVENT),
        "sensor": (*_OPERATOR, *_SENSORS, *shared["sensor"], keys.EVENT),
        "observer": (keys.log(_ANY), keys.EVENT),
        "console": (*_ASKED, keys.ESTOP, keys.ESTOP_PRESSED, keys.EVENT),
        "viewer": (),
        "operator": (
            *commands,
            *signals,
            *_ASKED,
            keys.RUNBOOK,
            keys.ESTOP,
            keys.ESTOP_PRESSED,
            keys.CONTROLLER,
            keys.POLICY,
            keys.TWIN,
            keys.host(_ANY),
            keys.EVENT,
        ),
    }


_MORE = {"recorder": "+psync +replconf +del +multi +exec", "operator": "+del", "console": "+del"}
_PLACEHOLDER = "PASSWORD-OF-{role}"


def new_passwords() -> dict[str, str]:
    """Return a new password for each role; what `rules` prints of it is only its hash."""
    return {role: secrets.token_urlsafe(24) for role in ROLES}


def rules(hashes: Mapping[str, str], servers: Mapping[str, Collection[str]] | None = None) -> str:
    """Return the list, one user a line; any other user, the default one included, is refused.

    Args:
        hashes: SHA-256 of the password by role, in hex; a role without one gets a placeholder to be replaced.
        servers: As of `writes`.
    """
    lines = ["user default reset off"]
    lines += [_user(role, hashes.get(role), patterns) for role, patterns in writes(servers).items()]
    return "\n".join(lines) + "\n"


def sha256(password: str) -> str:
    """Return the hash of a password as the list has it."""
    return hashlib.sha256(password.encode()).hexdigest()


def _user(role: str, digest: str | None, patterns: Iterable[str]) -> str:
    password = f"#{digest}" if digest else ">" + _PLACEHOLDER.format(role=role)
    more = _MORE.get(role, "").split()
    keyspace = [f"%W~{name}" for pattern in patterns for name in _with_stamp(pattern)]
    press = f"({_WRITE} %W~{keys.ESTOP_PRESSED} %W~{keys.stamp(keys.ESTOP_PRESSED)})"  # who may delete, not this one
    return " ".join(
        ["user", role, "reset", "on", password, "resetchannels", "&__keyspace@*__:*", "%R~*", *keyspace, "-@all",
         *_READ.split(), *_WRITE.split(), *more, press]
    )  # fmt: skip


def _with_stamp(key: str) -> tuple[str, ...]:
    """Return a pattern and that of its stamps; one that ends in a star has them in itself."""
    return (key,) if key.endswith(_ANY) else (key, keys.stamp(key))
