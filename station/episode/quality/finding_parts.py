"""What a check finds of keys, of cameras, of motion, and of a command beside the state that it was used with."""

from __future__ import annotations

from typing import Literal

import msgspec

from station.contract import Role


class RulesFile(msgspec.Struct, frozen=True):
    """A file of rules that an episode was judged by: its path (``shipped`` for what comes with us), and its hash."""

    file: str
    sha256: str


class KeyChanges(msgspec.Struct, frozen=True, kw_only=True):
    """Changes of one key by one command: the command (``deleted`` for any deletion), how many, and the first of them.

    `key` is "" where the tap does not know which; `at_s` is from the start of the episode [s]. `role` is that of the
    key, or of the key whose stamp it is, None where nothing describes it.
    """

    command: str
    key: str
    count: int
    at_s: float
    role: Role | None = None


class KeyPresence(msgspec.Struct, frozen=True, kw_only=True):
    """How a rated key lies in the episode, of all its writers.

    Attributes:
        key, role: The key, and its role by the recorded contract.
        writer: Server that wrote it last, or ``foreign``.
        nominal_hz: Rate by contract [Hz].
        late_s, early_s: From the start of the episode to the first message, and from the last one to its end [s].
        between_s: Longest time between two processes that wrote it one after the other [s].
        is_end_told: Whether its last writer had said that its commands end, or that it ends.
    """

    key: str
    role: str
    writer: str
    nominal_hz: float
    late_s: float
    early_s: float
    between_s: float
    is_end_told: bool


LossKind = Literal["server-died", "server-given-up", "server-restarted", "server-silent", "camera-lost", "lidar-lost"]


class Loss(msgspec.Struct, frozen=True, kw_only=True):
    """An event that says that a server died or fell silent, or that a camera was lost.

    Attributes:
        kind: Name of the event.
        server: The server that died, or the camera's.
        role: Its role by its own word, "" where it said none.
        at_s: When it was said, from the start of the episode [s].
        reason: Why, as the event says.
    """

    kind: LossKind
    server: str
    role: str
    at_s: float
    reason: str


class Silence(msgspec.Struct, frozen=True, kw_only=True):
    """The longest time between two words of a server that it works, which it says twice a second.

    `at_s` is when it began, from the start of the episode, and `seconds` how long it was [s].
    """

    server: str
    at_s: float
    seconds: float


class CameraQuality(msgspec.Struct, frozen=True, kw_only=True):
    """The pictures of one camera, by the times at which they were taken.

    Attributes:
        name: The camera.
        key: Its key on the bus.
        frames: Pictures in the file.
        expected: Pictures that belong between the first and the last: those that are there, and `missing`.
        missing: The greater of two counts: `lost`, and the empty places on the camera's own beat, where a camera or its
            line dropped what never got a number.
        lost: Sequence numbers that are not in the file, what the recorder dropped included.
        drop_share: `missing` of `expected`, 0..1.
        rate_hz: The camera's own rate, from its usual intervals [Hz]; None for fewer than two pictures.
        nominal_hz: Rate that it was set to, by the word of its server, else by contract [Hz].
        longest_gap_s, gap_at_s: Longest time between two pictures, and when it began from the start of the episode [s].
        age_p50_s, age_p99_s: From the taking of a picture to its write [s]; 0 where the camera does not say.
        ahead_s: How long before it was taken, by its own time, a picture was written at most [s]; 0 for never.
    """

    name: str
    key: str
    frames: int
    expected: int
    missing: int
    lost: int
    drop_share: float
    rate_hz: float | None
    nominal_hz: float | None
    longest_gap_s: float | None
    gap_at_s: float | None
    age_p50_s: float | None
    age_p99_s: float | None
    ahead_s: float = 0.0


class MotionQuality(msgspec.Struct, frozen=True, kw_only=True):
    """How one robot's joints moved; `station.episode.quality.motion` states the formulas.

    Attributes:
        robot: Suffix of its keys.
        state_key, command_key: Where the positions come from; "" where there are none.
        samples: Measured positions.
        idle_head_s, idle_tail_s: Time at the beginning and at the end in which neither command nor state moved [s];
            where nothing ever moved the head is all of it, and the tail 0.
        idle_below_rad: What counts as moving: a joint that covers more than this ...
        idle_window_s: ... within this time.
        jerk_p99_rad_s3, jerk_max_rad_s3: 99th percentile and greatest of the jerk of the joint that jerks most, over
            all instants [rad/s^3]; None where too few samples follow each other.
        worst_jerk_joint: The joint with the greatest.
        command_jerk_p99_rad_s3, command_worst_jerk_joint: The same of the positions that were commanded.
        is_carried: As in `station.description.RobotDescription`: it may be still, and at its ends.
        limits_from: What says where the joints end; "" where nothing does, and the next three say nothing.
        limit_hits: How often a joint came to its end.
        limit_share: Share of time that the joint was at its end which was there longest, 0..1.
        limit_joints: That share for each joint that ever was, the longest first.
        beyond_limit_rad: How far beyond its end a joint was at most [rad]; negative when all stayed within.
    """

    robot: str
    state_key: str
    command_key: str
    samples: int
    idle_head_s: float
    idle_tail_s: float
    idle_below_rad: float
    idle_window_s: float
    jerk_p99_rad_s3: float | None
    jerk_max_rad_s3: float | None
    worst_jerk_joint: str
    limits_from: str
    limit_hits: int
    limit_share: float
    limit_joints: dict[str, float]
    beyond_limit_rad: float | None
    command_jerk_p99_rad_s3: float | None = None
    command_worst_jerk_joint: str = ""
    is_carried: bool = False


class ArmQuality(msgspec.Struct, frozen=True, kw_only=True):
    """What an arm's session with its controller counted during the episode; `station.episode.quality.arms` says how.

    Attributes:
        robot: Suffix of its keys.
        backend: ``kord`` for a real controller, ``sim`` for a simulated one.
        profiles: How targets were tracked, in the order in which these profiles were chosen.
        sync_hz: Heartbeats of the controller that were heard [Hz].
        sends: Targets of the stream that were sent.
        sends_moving_hz, moving_s: How often in motion [Hz], and how long that was [s].
        sends_holding_hz, holding_s: How often while the target stood [Hz], and how long that was [s].
        faults: Faults of the controller.
        late_commands, sync_timeouts, missed_ticks, limit_refusals, commands_dropped_by_throttle: As counted.
        sync_to_send_p50_s, sync_to_send_p99_s, sync_to_send_max_s: From a heartbeat to the sending of a command, since
            the session began [s], the greatest of several sessions; None where nothing was measured.
        period_p99_s, period_max_s: Likewise between two heartbeats.
    """

    robot: str
    backend: str
    profiles: list[str]
    sync_hz: float | None
    sends: int
    sends_moving_hz: float | None
    moving_s: float
    sends_holding_hz: float | None
    holding_s: float
    faults: int
    late_commands: int
    sync_timeouts: int
    missed_ticks: int
    limit_refusals: int
    commands_dropped_by_throttle: int
    sync_to_send_p50_s: float | None = None
    sync_to_send_p99_s: float | None = None
    sync_to_send_max_s: float | None = None
    period_p99_s: float | None = None
    period_max_s: float | None = None


class Alignment(msgspec.Struct, frozen=True, kw_only=True):
    """How the applied command lies beside the state that it was used with, over the steps that followed a command.

    Attributes:
        robot: Suffix of its keys.
        state_key: The state.
        steps: Steps with both instants.
        lead_p50_s, lead_p99_s, lead_least_s, lead_max_s: How long before the state was read the command was written
            (arrived, for a writer without stamps) [s]. Negative: the command is younger than the state, as in
            lock-step.
        repeated: Steps that used the command of the step before once more.
        skipped: Commands that no step used.
        lag_s: By how much the measured joints follow the applied command: the shift at which their speeds agree best
            [s]. None where too little moved, or nothing agrees. Negative: the state moves before its command, so times
            are wrong.
        lag_correlation: How well they agree at that shift, up to 1.
    """

    robot: str
    state_key: str
    steps: int
    lead_p50_s: float | None
    lead_p99_s: float | None
    lead_least_s: float | None
    lead_max_s: float | None
    repeated: int
    skipped: int
    lag_s: float | None
    lag_correlation: float | None


class Seen(msgspec.Struct, frozen=True):
    """How many pictures something was seen of, and when it was first seen, from the start of the episode [s]."""

    count: int = 0
    first_s: float | None = None


class DepthQuality(msgspec.Struct, frozen=True, kw_only=True):
    """What depth pictures say beside their bytes.

    Attributes:
        measured_share: Mean share of the pixels looked at in which there is a depth, 0..1; None for no picture.
        blind: Pictures looked at in which there is none at all.
        blind_s, blind_at_s: Longest time from one such to the last one in a row, and when it began [s].
    """

    measured_share: float | None
    blind: Seen
    blind_s: float
    blind_at_s: float | None


class PictureQuality(msgspec.Struct, frozen=True, kw_only=True):
    """What the pictures of one camera are worth; `station.episode.quality.picture_contents` says how it is measured.

    Attributes:
        name: The camera.
        key: Its key on the bus.
        pictures: Pictures in the file.
        sizes: Their sizes [px] in the order in which they came, the first few.
        resized: Pictures of another size than the first one.
        torn: Pictures that are no whole JPEG file, of depth PNG file.
        repeats: Pictures that are the one before once more, byte for byte.
        moving: Pictures that were taken while joints surely moved.
        repeats_moving: How many of those are such repeats, outside of freezes (the same picture for 0.5 s and longer).
        still_s, still_at_s: Longest freeze, and when it began [s]; whether anything moved or not.
        frozen_s, frozen_at_s: Longest time for which joints surely moved within one freeze, and when that began [s].
        looked_at: Pictures that were decoded, or should have been; the next six count of these.
        decoder: Library that decoded them.
        unreadable: Whole by their ends, and not to be decoded.
        black, white, flat: Pictures that show nothing: dark, blown out, or of one colour.
        exposure_jumps: Pictures that show what the one looked at before showed, in a brightness quite different.
        brightness: Mean grey, 0 to 255; None where nothing could be decoded.
        sharpness: Median variance of the Laplacian of the small grey pictures; compares pictures of one size and scene.
        noise, turned, cut, relative_sharpness, focus_lost_s: Of `station.episode.quality.picture_views`.
        exchanged_with, exchanged_s: The camera that it changed places with in the middle, and when [s]; "" for none.
        first_view: Mean of the first pictures looked at, 12x12 bytes of grey in base64; "" for none.
        depth: Of depth pictures, for which all between `unreadable` and this one stays empty; None for others.
    """

    name: str
    key: str
    pictures: int
    sizes: list[str]
    resized: Seen
    torn: Seen
    repeats: int
    moving: int
    repeats_moving: Seen
    still_s: float
    still_at_s: float | None
    frozen_s: float
    frozen_at_s: float | None
    looked_at: int
    decoder: str
    unreadable: Seen
    black: Seen
    white: Seen
    flat: Seen
    exposure_jumps: Seen
    noise: Seen
    turned: Seen
    cut: Seen
    relative_sharpness: float | None
    focus_lost_s: float | None
    brightness: float | None
    sharpness: float | None
    exchanged_with: str = ""
    exchanged_s: float = 0.0
    first_view: str = ""
    depth: DepthQuality | None = None


class CameraSwap(msgspec.Struct, frozen=True):
    """A camera that took another's place.

    Attributes:
        camera: Name that it has.
        was: Name that it had in the earlier episode.
        told_by: ``serial``: by the serial number of its device. ``likeness``: by what both cameras see.
        episode_id: The earlier episode.
    """

    camera: str
    was: str
    told_by: Literal["serial", "likeness"]
    episode_id: str


class ContractDifference(msgspec.Struct, frozen=True):
    """A key whose recorded contract is not what the robot's server states of it, and the first element that differs."""

    key: str
    place: int
    recorded: str
    stated: str


class ValueFaults(msgspec.Struct, frozen=True, kw_only=True):
    """Values of one key that cannot be; `station.episode.quality.values` says which are looked at.

    Times are of the first one, from the start of the episode [s].

    Attributes:
        key: The key.
        writes: Its writes.
        unfit, unfit_at_s: Writes that hold other than the numbers of its contract.
        not_finite, not_finite_name, not_finite_at_s: Writes with a number that is none or infinite, and its element.
        beyond_turn, beyond_turn_name, beyond_turn_rad, beyond_turn_at_s: Writes with an angle that no joint reaches,
            more than one turn as a rule; the element that is furthest, and how far [rad].
        odd_quaternions, odd_norm, odd_at_s: Quaternions whose length is not 1, and the length that is furthest from it.
    """

    key: str
    writes: int
    unfit: int = 0
    unfit_at_s: float | None = None
    not_finite: int = 0
    not_finite_name: str = ""
    not_finite_at_s: float | None = None
    beyond_turn: int = 0
    beyond_turn_name: str = ""
    beyond_turn_rad: float = 0.0
    beyond_turn_at_s: float | None = None
    odd_quaternions: int = 0
    odd_norm: float = 1.0
    odd_at_s: float | None = None


class FrozenState(msgspec.Struct, frozen=True, kw_only=True):
    """Equal states in a row though the robot moved; `station.episode.quality.frozen` says when that is so.

    Attributes:
        seconds: Of all such times [s].
        longest_s, at_s, writes: The longest, when it began from the start of the episode [s], and its writes.
    """

    seconds: float
    longest_s: float
    at_s: float
    writes: int


class StuckJoint(msgspec.Struct, frozen=True, kw_only=True):
    """A joint that stood still at a position [rad] though its applied command covered an angle [rad].

    `at_s` is when the longest such time began, from the start of the episode, and `seconds` how long it was [s].
    """

    joint: str
    at_s: float
    seconds: float
    position_rad: float
    asked_rad: float


class PositionJump(msgspec.Struct, frozen=True, kw_only=True):
    """A joint whose position went further from one state to the next than its velocity explains.

    Attributes:
        joint: The joint.
        at_s, by_rad: The first time, from the start of the episode [s], and by how much [rad].
        count: How often.
        joints: How many joints jumped with it that time.
    """

    joint: str
    at_s: float
    by_rad: float
    count: int
    joints: int


class MisplacedJoint(msgspec.Struct, frozen=True):
    """A joint that follows the command of another one: how far it goes with its own, and with that one, up to 1."""

    joint: str
    follows: str
    own_agreement: float
    other_agreement: float


class StepTimes(msgspec.Struct, frozen=True, kw_only=True):
    """How states and commands lie to the recorded instants of the steps; see `station.episode.quality.step_times`.

    Attributes:
        steps: Steps that saw a state.
        state_off_s, command_off_s: By how much the file's time of states, and of commands, is after the instant that
            the steps have for it, nine of ten at least [s]; negative: before. None where nothing says.
        before_written_share: Share of steps that used their command before it was written, 0..1.
        commands_ahead: By how many commands `command_used` is ahead of the one that its step names.
        command_difference: Mean difference of both; None where they were not compared.
        reused_states_share, reused_at_s: Share of steps that saw the state of the step before, 0..1, and the first of
            them; of robots that write one for each step.
        command_key: Key of the commands; "" where the steps follow none that holds the same elements.
        untimed: Steps, of `timed`, that tell no instant of their own.
        timed: Steps that have a timing.
    """

    steps: int
    state_off_s: float | None
    command_off_s: float | None
    before_written_share: float
    commands_ahead: int
    command_difference: float | None
    reused_states_share: float
    reused_at_s: float | None
    command_key: str
    untimed: Seen
    timed: int


class Plausibility(msgspec.Struct, frozen=True, kw_only=True):
    """Whether one robot's states and commands can be so; `station.episode.quality.plausibility` says how it is found.

    Attributes:
        robot: Suffix of its keys.
        state_key: The state that was looked at; "" for none.
        values: Keys with values that cannot be.
        frozen: Equal states in a row; None for none.
        stuck: Joints that were stuck, the longest first.
        repeats: States, of the `moving` ones, that are the one before once more.
        moving: States that came while it moved.
        orientation_agreement: How far each axis of the gyro agrees with the turning of the orientation, up to 1; of
            those about which that turned.
        gyro_factor: Gyro as recorded for each rad/s of the orientation; None where nothing agrees.
        velocity_agreement: How far the velocity of each joint that moved agrees with its positions, up to 1.
        velocity_like: Joints whose positions agree best with the velocity of another one, and of which.
        velocity_factor: Velocity as recorded for each rad/s of the positions, median; None where nothing agrees, 0 for
            nothing but zeros.
        jumps: Joints whose positions jumped.
        misplaced: Joints that follow each other's commands.
        reversed: Joints that move against their own commands, with how far they agree, down to -1.
        offsets_rad: Joints that follow their own commands and stay beside them by the same angle, and by which [rad].
        times: How states and commands lie to the steps' instants; None where there are too few steps.
    """

    robot: str
    state_key: str
    values: list[ValueFaults]
    frozen: FrozenState | None
    stuck: list[StuckJoint]
    repeats: Seen
    moving: int
    orientation_agreement: dict[str, float]
    gyro_factor: float | None
    velocity_agreement: dict[str, float]
    velocity_like: dict[str, str]
    velocity_factor: float | None
    jumps: list[PositionJump]
    misplaced: list[MisplacedJoint]
    reversed: dict[str, float]
    offsets_rad: dict[str, float]
    times: StepTimes | None
