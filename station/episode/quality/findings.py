"""What a check finds of an episode, and what it is judged by; every number comes from the file."""

from __future__ import annotations

from typing import Literal

import msgspec

from station.control.tracking import VelocityFound
from station.episode.quality.finding_parts import (
    Alignment,
    ArmQuality,
    CameraQuality,
    CameraSwap,
    ContractDifference,
    KeyChanges,
    KeyPresence,
    Loss,
    MotionQuality,
    PictureQuality,
    Plausibility,
    RulesFile,
    Seen,
    Silence,
)
from station.episode.storage.file_hashes import FileChange
from station.episode.storage.manifest_parts import AuditFound, RecordedFile

Verdict = Literal["good", "usable", "reject"]

TimesOf = Literal["writers", "polled", "nominal"]
"""Where the times of messages come from: writers (or arrival), a recorder that polled the bus, or a nominal rate."""


class Spread(msgspec.Struct, frozen=True):
    """Median, 99th percentile and greatest of a quantity over `count` values [s]; None when there are none."""

    count: int
    p50_s: float | None = None
    p99_s: float | None = None
    max_s: float | None = None


class StreamQuality(msgspec.Struct, frozen=True, kw_only=True):
    """One key as one source wrote it, measured on the writer's own times where it stamps them.

    Attributes:
        key: Key on the bus.
        source: Full source of a native writer, "" for a foreign one.
        writer: Server name, or ``foreign``.
        role: Role by the recorded contract, or ``unknown``.
        is_native: Whether its writes are numbered, so that a loss would show.
        count: Messages in the file.
        lost: Sequence numbers missing between the least and the greatest, without as many as the recorder dropped;
            always 0 for a foreign writer.
        lost_at_s: When the last message before the first that is missing was, from the start of the episode [s].
        dropped, dropped_bulky: As in `station.episode.storage.manifest.Stream`.
        repeated: Messages whose number was there already.
        out_of_order: Messages whose number is smaller than that of the message before.
        rate_hz: Mean rate [Hz]; None for fewer than two messages.
        nominal_hz: Rate by contract [Hz]; None for keys written on events only.
        jitter_p50_s, jitter_p99_s: How far intervals differ from the median interval [s].
        longest_gap_s, gap_at_s: Longest interval, and when it began from the start of the episode [s].
        slowest_s, slowest_at_s: Longest time that the writes of one second, by the median interval, took, and when that
            began [s]; None for fewer.
        first_s, last_s: First and last message, from the start of the episode [s].
        paused_s: Sum of the intervals of which its writer had said that its commands end [s]; they count in none of the
            numbers before.
    """

    key: str
    source: str
    writer: str
    role: str
    is_native: bool
    count: int
    lost: int
    repeated: int
    out_of_order: int
    rate_hz: float | None
    nominal_hz: float | None
    jitter_p50_s: float | None
    jitter_p99_s: float | None
    longest_gap_s: float | None
    gap_at_s: float | None
    first_s: float
    last_s: float
    lost_at_s: float | None = None
    slowest_s: float | None = None
    slowest_at_s: float | None = None
    dropped: int = 0
    dropped_bulky: int = 0
    paused_s: float = 0.0


class RivalWriters(msgspec.Struct, frozen=True):
    """Writers that wrote one command key at the same time, and for how long [s]."""

    key: str
    writers: list[str]
    overlap_s: float


class CommandPause(msgspec.Struct, frozen=True, kw_only=True):
    """A pause between two commands that the writer of the first had announced.

    Attributes:
        at_s: Last command before it, from the start of the episode [s].
        seconds: Until the next command of any writer [s].
        keys: Command keys that were silent.
        writer: Server that ended its commands.
        reason: Why, as it said.
    """

    at_s: float
    seconds: float
    keys: list[str]
    writer: str
    reason: str


class FallSeen(msgspec.Struct, frozen=True, kw_only=True):
    """One fall.

    Attributes:
        at_s: When it was first seen, from the start of the episode [s].
        robot: Suffix of the robot, "" when only an event tells of it.
        tilt_rad: Tilt of the torso then [rad].
        seen_by: ``event`` (the robot's server said so) or ``pose`` (derived from the recorded pose).
        contacts: Bodies that touched the ground, as the event named them.
    """

    at_s: float
    robot: str
    tilt_rad: float | None
    seen_by: Literal["event", "pose"]
    contacts: list[str] = []


class Interruption(msgspec.Struct, frozen=True, kw_only=True):
    """A time in which the bus, or a process's connection to it, did not work.

    Attributes:
        kind: ``bus-silent``: the bus owed answers, and gave them afterwards. ``bus-lost``: servers had no connection.
            ``bus-refused``: writes were answered with an error. ``bulk-cut``: one of these, of the bulk bus.
            ``watch-cut``: a server did not hear what was written.
            ``tap-cut``: the recorder was cut off, and went on where it was. ``hole``: it could not, and writes are
            missing or may be. ``recorder-restart``: it was killed, and another took the episode up.
        at_s: When it began, from the start of the episode [s].
        seconds: How long it lasted [s]; None where it did not end.
        lost: Writes that it cost; None where that is not known.
        told_by: Servers that told of it.
        reason: Why, as they said.
    """

    kind: Literal[
        "bus-silent", "bus-lost", "bus-refused", "bulk-cut", "watch-cut", "tap-cut", "hole", "recorder-restart"
    ]
    at_s: float
    seconds: float | None = None
    lost: int | None = None
    told_by: list[str] = []
    reason: str = ""


class StepQuality(msgspec.Struct, frozen=True, kw_only=True):
    """The policy steps of one robot.

    Attributes:
        robot: Suffix of its keys.
        steps: Steps in the file.
        missing_steps: Steps whose number is missing between the first and the last of a source.
        command_age: Age of the command at the instant the policy used it, from the first to the last step that
            followed one, pauses of the commands left out: since it was written, or, for a writer without stamps, since
            it arrived.
        stages: Time between consecutive instants of a step, named ``command_written_to_command_arrived`` … and
            ``command_written_to_sent``. Negative in lock-step, where the command answers the state.
        gate_shares: Share of time in each state of the gate, 0..1.
        interrupted_share: Share of the time between the first and the last tracking step that was not tracking, pauses
            of the commands left out.
        clamped, refused: Greatest counts that the gate reported; None where it reported none.
        lacking: Keys that nearly all steps hold and some do not: in how many it is missing, and when first.
        compared_steps: Steps in which the gate was tracking and the motion playing.
        mean_joint_error_rad: Over those steps, as `station.control.tracking` defines it, so that it compares with a
            rehearsal [rad]; None where no joint is commanded.
        worst_joint, worst_joint_error_rad: The joint with the greatest mean error.
        joint_errors_rad: Mean error of each joint [rad].
        mean_root_height_error_m: Likewise for the height of the root [m]; simulation only.
        velocity: Likewise for the velocity of the base; None where none is commanded, or the robot knows no place.
    """

    robot: str
    steps: int
    missing_steps: int
    command_age: Spread
    stages: dict[str, Spread]
    gate_shares: dict[str, float]
    interrupted_share: float
    clamped: int | None
    refused: int | None
    lacking: dict[str, Seen]
    compared_steps: int
    mean_joint_error_rad: float | None
    worst_joint: str
    worst_joint_error_rad: float | None
    joint_errors_rad: dict[str, float]
    mean_root_height_error_m: float | None
    velocity: VelocityFound | None = None


class Reason(msgspec.Struct, frozen=True):
    """Why an episode is not good: name of the rule, what it makes of the episode, and the fact in a sentence."""

    rule: str
    verdict: Verdict
    text: str


class Quality(msgspec.Struct, kw_only=True):
    """Everything that a check finds.

    Attributes:
        episode_id: The episode.
        verdict: ``good``, ``usable`` (whole enough, with the reasons to think twice) or ``reject``: whether it may
            go into a training set as a demonstration.
        reasons: Why it is not good; empty for a good one.
        rules: The files of rules that it was judged by, the later ones over the earlier.
        duration_s: From the first message to the last [s]; of those before its start too.
        messages: Messages in the file.
        streams: By key and source.
        steps: By robot.
        alignment: How commands lay beside states, by robot.
        motion: How joints moved, by robot.
        arms: What the sessions of arms with their controllers counted, by robot.
        plausibility: Whether what states and commands say can be so, by robot.
        contract_differences: Recorded contracts that are not what the robot's server states.
        cameras: What became of the pictures, by camera.
        pictures: What the pictures are worth, by camera.
        swapped_cameras: Cameras that changed places since the first episode of the task.
        ends_s: From when to when there is an episode, from its start [s].
        presence: How each rated key lies in it.
        no_pictures: Keys of cameras and lidars that were there, and of which there is no picture or cloud.
        silences: The longest silence of each server.
        losses: Servers that died or fell silent and cameras that were lost, by events.
        rivals: Command keys with several writers at once.
        pauses: Times without commands that their writer told of beforehand, in order.
        falls: Number of falls, by event or by pose.
        falls_seen: Each of them.
        resets, estops: Number of such events.
        interruptions: Of the bus and of the lines to it, in order; what several servers tell of is one.
        bus_lost: Number of those in which the bus was lost.
        events: Number of events by name.
        recorder_restarts: How often a recorder took the episode up again.
        dropped: Writes that the recorder saw and could not keep.
        dropped_bulky: How many of them were images or other bulky values.
        dropped_keys: The keys that they were of, those that lost most first, with how many.
        not_mirrored: Writes whose values the recorder's tap could not know: they reached the bus and are not in the
            file.
        deletions: Deletions of keys, by key.
        holes: Spans of which writes are missing, as the recorder stated them.
        backend, is_lossless: The tap that was used, and whether it can promise every write.
        lock_step: Whether commands waited for states, so that times say nothing of the control.
        times_of: Whose times it has; other than ``writers`` only in what was imported.
        not_judged: Rules that these times cannot answer, and why.
        is_finished: Whether the recorder closed the file.
        torn: What was cut off, in a line; None for a whole file.
        success: What the operator said; None when nobody did.
        discarded: Whether it was marked as not to be used.
        files: The files that were measured, so that it can be told later whether the verdict is of these.
        changed: Files that are not those that were closed, by the manifest; empty where it tells nothing of them.
        manifest_changed: Fields of the manifest that are not what the recording says of itself.
        audit: What an audit found; None where there was none.
        shortened: What did not fit into the manifest, see `station.episode.storage.manifest.Manifest`.
    """

    episode_id: str
    verdict: Verdict = "good"
    reasons: list[Reason] = []
    rules: list[RulesFile] = []
    duration_s: float = 0.0
    messages: int = 0
    streams: list[StreamQuality] = []
    steps: list[StepQuality] = []
    alignment: list[Alignment] = []
    motion: list[MotionQuality] = []
    arms: list[ArmQuality] = []
    plausibility: list[Plausibility] = []
    contract_differences: list[ContractDifference] = []
    cameras: list[CameraQuality] = []
    pictures: list[PictureQuality] = []
    swapped_cameras: list[CameraSwap] = []
    ends_s: tuple[float, float] = (0.0, 0.0)
    presence: list[KeyPresence] = []
    no_pictures: list[str] = []
    silences: list[Silence] = []
    losses: list[Loss] = []
    rivals: list[RivalWriters] = []
    pauses: list[CommandPause] = []
    falls: int = 0
    falls_seen: list[FallSeen] = []
    resets: int = 0
    estops: int = 0
    interruptions: list[Interruption] = []
    bus_lost: int = 0
    events: dict[str, int] = {}
    recorder_restarts: int = 0
    dropped: int = 0
    dropped_bulky: int = 0
    dropped_keys: dict[str, int] = {}
    not_mirrored: list[KeyChanges] = []
    deletions: list[KeyChanges] = []
    holes: int = 0
    backend: str = ""
    is_lossless: bool = False
    lock_step: bool = False
    times_of: TimesOf = "writers"
    not_judged: dict[str, str] = {}
    is_finished: bool = True
    torn: str | None = None
    success: bool | None = None
    discarded: bool = False
    files: list[RecordedFile] = []
    changed: list[FileChange] = []
    manifest_changed: list[str] = []
    audit: AuditFound | None = None
    shortened: dict[str, int] = {}

    @property
    def length_s(self) -> float:
        """How long the episode is, from its start to its end [s]."""
        return self.ends_s[1] - self.ends_s[0] or self.duration_s

    def joint_errors_rad(self, robot: str) -> dict[str, float]:
        """Return the mean error of each joint of a robot that was compared [rad]."""
        return next((steps.joint_errors_rad for steps in self.steps if steps.robot == robot), {})
