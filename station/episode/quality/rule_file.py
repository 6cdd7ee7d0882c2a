"""What an episode is judged by: typed rules, filled by the YAML file that ships with us and a lab's own over it.

``quality.yaml`` beside this module holds every rule with its limits; a lab's file holds what differs.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import msgspec

from station import config, user_config
from station.episode.quality.finding_parts import RulesFile
from station.errors import ConfigError

SHIPPED = Path(__file__).with_name("quality.yaml")
SHIPPED_NAME = "shipped"

Says = Literal["reject", "usable", "off"]


class Rule(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A rule that finds something or does not, and the verdict for it; ``off``: it is not asked."""

    verdict: Says

    def __post_init__(self) -> None:
        limits = {name: value for name in self.__struct_fields__ if isinstance(value := getattr(self, name), float)}
        for name, value in limits.items():
            if math.isnan(value):
                raise ValueError(f"{name}: expected a number, got nan")
        for name, reject in limits.items():
            usable = limits.get(name.replace("reject_", "usable_"), reject)
            if usable > reject:
                raise ValueError(f"the limit for usable, {usable:g}, lies above the one for reject, {reject:g}")


class GradedRule(Rule, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A rule that says usable or reject by itself; `verdict` is the worst that it may say."""


class Losses(GradedRule, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Any is usable; more than this share, 0..1, is not."""

    reject_above_share: float


class Shares(GradedRule, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Limits of a share, 0..1."""

    usable_above_share: float
    reject_above_share: float


class Seconds(GradedRule, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Limits of a time [s]."""

    usable_above_s: float
    reject_above_s: float


class Ends(GradedRule, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Limits of what is missing at an end of the episode: usable above a time [s], not above a share of it, 0..1."""

    usable_above_s: float
    reject_above_share: float


class Angles(GradedRule, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Limits of an angle [rad]."""

    usable_above_rad: float
    reject_above_rad: float


class LeastShare(Rule, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The least share, 0..1."""

    below_share: float


class MostShare(Rule, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The greatest share, 0..1."""

    above_share: float


class MostSeconds(Rule, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The longest time [s]."""

    above_s: float


class MostAge(Rule, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The greatest 99th percentile of an age [s]."""

    p99_above_s: float


class Lag(Rule, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Least and greatest lag of the joints behind the command [s]."""

    lag_below_s: float
    lag_above_s: float


class MostMetres(Rule, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The greatest distance [m]."""

    above_m: float


class MostRate(Rule, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The greatest rate [Hz]."""

    above_hz: float


class LeastSharpness(Rule, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The least sharpness: variance of the Laplacian of a small picture over that of its grey."""

    below: float


class MostJerk(Rule, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The greatest 99th percentile of a jerk [rad/s^3]."""

    p99_above_rad_s3: float


class LeastAgreement(Rule, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The least agreement of two signals, up to 1."""

    below: float


class MostFactor(Rule, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """By what factor, or by one over it, a scale may be off."""

    above_factor: float


class MostTimes(GradedRule, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How often something may happen that is usable still."""

    usable_up_to: float


class PictureAges(Seconds, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Limits of the age of pictures, and of how much younger than nothing they may be [s]."""

    ahead_above_s: float


class Limits(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, rename="kebab"):
    """Every rule by its name, which has dashes in the file; what each looks at is told there."""

    empty: Rule
    torn: Rule
    unfinished: Rule
    changed: Rule
    manifest_changed: Rule
    audit_differs: Rule
    discarded: Rule
    failed_task: Rule
    fell: Rule
    operator_reset: Rule
    estop: Rule
    lost: Losses
    dropped: Rule
    dropped_images: Rule
    disordered: Rule
    lossy_tap: Rule
    holes: Rule
    began_late: Ends
    ended_early: Ends
    writer_gap: Seconds
    server_died: GradedRule
    not_mirrored: GradedRule
    deleted: Rule
    gap: Seconds
    device_gap: MostSeconds
    device_slow: MostSeconds
    server_paused: MostSeconds
    slow: LeastShare
    rival_writers: Rule
    bus_silent: Rule
    bus_lost: Rule
    bus_refused: Rule
    no_pictures: Rule
    camera_began_late: Ends
    camera_ended_early: Ends
    camera_lost: Rule
    camera_drops: Shares
    camera_gap: Seconds
    camera_slow: LeastShare
    camera_torn: Losses
    camera_resized: Rule
    camera_frozen: Seconds
    camera_repeats: MostShare
    camera_black: Shares
    camera_saturated: MostShare
    camera_flat: MostShare
    camera_exposure: MostShare
    camera_blurred: LeastSharpness
    camera_noise: MostShare
    camera_cut: MostShare
    camera_turned: Rule
    camera_blind: Seconds
    cameras_swapped: Rule
    no_steps: Rule
    missing_keys: Rule
    incomplete_steps: Shares
    never_tracked: Rule
    commands_ended: Rule
    interrupted: Shares
    old_command: MostAge
    misaligned: Lag
    poor_tracking: Angles
    wrong_height: MostMetres
    idle_ends: MostSeconds
    jerky: MostJerk
    jerky_command: MostJerk
    joint_limits: MostShare
    arm_fault: Rule
    arm_sync: LeastShare
    arm_flood: MostRate
    unfit_values: Losses
    not_radians: Losses
    quaternion_norm: Losses
    frozen_state: Seconds
    stuck_joint: Seconds
    repeated_states: MostShare
    position_jump: MostTimes
    orientation_disagrees: LeastAgreement
    gyro_scale: MostFactor
    velocity_disagrees: LeastAgreement
    velocity_scale: MostFactor
    joint_order: Rule
    joint_reversed: Rule
    joint_offset: Angles
    beyond_limits: Angles
    step_times: Seconds
    untimed_steps: MostShare
    before_written: MostShare
    command_ahead: Rule
    reused_states: Shares
    camera_times: PictureAges
    contract_differs: Rule

    def rule(self, name: str) -> Rule:
        """Return a rule by its name in the file."""
        found: Rule = getattr(self, name.replace("-", "_"))
        return found


@dataclass(frozen=True)
class RuleBook:
    """The rules, and the files that they come from, the first one ours."""

    limits: Limits
    files: tuple[RulesFile, ...]


@cache
def shipped() -> RuleBook:
    """Return the rules that ship with us."""
    return RuleBook(config.build(Limits, config.read_yaml(SHIPPED), where=str(SHIPPED)), (_hashed(SHIPPED),))


def load(path: Path) -> RuleBook:
    """Return our rules with those of a file over them.

    Raises:
        BadFile: no such file, or not readable.
        ConfigError: not YAML, an unknown rule or limit, or a value that does not fit.
    """
    own = {str(name): _plain(rule) for name, rule in config.read_yaml(path).items()}
    known = config.read_yaml(SHIPPED)
    for name, rule in own.items():
        if name in known and not isinstance(rule, Mapping):
            raise ConfigError(f"{path}: {name}: expected verdict and limits, or off; got {rule!r}")
    limits = config.build(Limits, config.merged(known, own), where=str(path))
    return RuleBook(limits, (*shipped().files, _hashed(path)))


def of_user() -> RuleBook:
    """Return the rules of this user: ``$XDG_CONFIG_HOME/station/quality.yaml`` over ours, or ours where there is none.

    Raises:
        BadFile, ConfigError: as `load`.
    """
    path = user_file()
    return load(path) if path.exists() else shipped()


def user_file() -> Path:
    """Return where this user's rules are kept; perhaps not there."""
    return user_config.folder() / "quality.yaml"


def _plain(rule: Any) -> Any:
    """Return what was written of a rule, with the words that YAML takes for something else: off is false to it."""
    if rule is False:
        return {"verdict": "off"}
    if isinstance(rule, Mapping) and rule.get("verdict") is False:
        return {**rule, "verdict": "off"}
    return rule


def _hashed(path: Path) -> RulesFile:
    name = SHIPPED_NAME if path == SHIPPED else str(path)
    return RulesFile(name, hashlib.sha256(path.read_bytes()).hexdigest())
