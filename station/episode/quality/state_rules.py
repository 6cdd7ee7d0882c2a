"""The rules about whether states, commands and the times of pictures can be so."""

from __future__ import annotations

from collections.abc import Iterator

from station.bus import keys
from station.episode.quality.cameras import told_apart
from station.episode.quality.finding_parts import Plausibility, ValueFaults
from station.episode.quality.findings import Quality, Verdict
from station.episode.quality.rule_file import Limits, Losses, MostFactor
from station.episode.quality.sensed_rules import Finder

_RESETS = ("operator-reset", "robot-reset")
_SEVERAL = 4  # joints that jump at once, as of a robot that is put on its feet
_LEAST_MOVING = 50  # states, below which a share says little


def _unfit_values(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for one in _value_faults(quality):
        for count, at_s, what in (
            (one.unfit, one.unfit_at_s, "hold other than the numbers of the contract"),
            (one.not_finite, one.not_finite_at_s, f"hold no finite number in {one.not_finite_name}"),
        ):
            if count:
                yield _of_writes(one, count, at_s, what, limits.unfit_values)


def _not_radians(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for one in _value_faults(quality):
        if one.beyond_turn:
            what = f"hold an angle that no joint reaches, {one.beyond_turn_name} up to {one.beyond_turn_rad:.1f} rad"
            yield _of_writes(one, one.beyond_turn, one.beyond_turn_at_s, what, limits.not_radians)


def _quaternion_norm(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for one in _value_faults(quality):
        if one.odd_quaternions:
            what = f"hold a quaternion that is no rotation, its length {one.odd_norm:.3g} and not 1"
            yield _of_writes(one, one.odd_quaternions, one.odd_at_s, what, limits.quaternion_norm)


def _value_faults(quality: Quality) -> Iterator[ValueFaults]:
    for robot in quality.plausibility:
        yield from robot.values


def _of_writes(one: ValueFaults, count: int, at_s: float | None, what: str, limit: Losses) -> tuple[Verdict, str]:
    verdict: Verdict = "reject" if count > limit.reject_above_share * one.writes else "usable"
    first = "" if at_s is None else f", the first at {at_s:.2f} s"
    return verdict, f"{one.key}: {count} of {one.writes} writes {what}{first}"


def _frozen_state(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.plausibility:
        found, limit = robot.frozen, limits.frozen_state
        if found is not None and found.longest_s > limit.usable_above_s:
            verdict: Verdict = "reject" if found.longest_s > limit.reject_above_s else "usable"
            where = f"for {found.longest_s:.2f} s from {found.at_s:.2f} s on"
            yield verdict, f"{robot.state_key}: {found.writes} equal states in a row {where}, though the robot moved"


def _stuck_joint(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.plausibility:
        found = [joint for joint in robot.stuck if joint.seconds > limits.stuck_joint.usable_above_s]
        if found:
            worst, more = found[0], f"; {len(found) - 1} more joint(s)" if len(found) > 1 else ""
            verdict: Verdict = "reject" if worst.seconds > limits.stuck_joint.reject_above_s else "usable"
            where = f"at {worst.position_rad:.3f} rad for {worst.seconds:.1f} s from {worst.at_s:.1f} s on"
            asked = f"while its command in {keys.command_used(robot.robot)} covered {worst.asked_rad:.2f} rad"
            yield verdict, f"{robot.state_key}: {worst.joint} stayed {where}, {asked}{more}"


def _orientation_disagrees(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.plausibility:
        found = robot.orientation_agreement
        worst = min(found, key=found.__getitem__, default="")
        if worst and found[worst] < limits.orientation_disagrees.below:
            why = "wrong order of the quaternion (wxyz), wrong frame, or inverted"
            text = f"{worst} agrees by {found[worst]:.2f} with the turning of the orientation, 1 expected: {why}"
            yield "reject", f"{robot.state_key}: {text}"


def _gyro_scale(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.plausibility:
        if _is_off(robot.gyro_factor, limits.gyro_scale):
            what = "rad/s of the gyro for each of the orientation"
            yield "usable", f"{robot.state_key}: {_scale(robot.gyro_factor, what)}"


def _velocity_disagrees(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.plausibility:
        found = _disagreeing(robot, limits.velocity_disagrees.below)
        if found:
            worst = min(found, key=found.__getitem__)
            like = f"; that of {robot.velocity_like[worst]} fits" if worst in robot.velocity_like else ""
            more = f"; {len(found) - 1} more joint(s)" if len(found) > 1 else ""
            text = f"the velocity of {worst} agrees by {found[worst]:.2f} with its positions, 1 expected{like}{more}"
            yield "reject", f"{robot.state_key}: {text}"


def _disagreeing(robot: Plausibility, limit: float) -> dict[str, float]:
    """Return the joints whose velocities are not those of their positions, with how far they agree.

    One that shakes faster than states are written agrees with nothing, and is sound. So a joint counts where another
    one's velocity fits, or the negative of its own, or where most joints agree with nothing.
    """
    below = {joint: share for joint, share in robot.velocity_agreement.items() if share < limit}
    if 2 * len(below) > len(robot.velocity_agreement):
        return below
    return {joint: share for joint, share in below.items() if joint in robot.velocity_like or share < -limit}


def _velocity_scale(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.plausibility:
        if _is_off(robot.velocity_factor, limits.velocity_scale):
            what = "rad/s of the velocities for each of the positions"
            yield "usable", f"{robot.state_key}: {_scale(robot.velocity_factor, what)}"


def _is_off(factor: float | None, limit: MostFactor) -> bool:
    return factor is not None and not 1.0 / limit.above_factor <= factor <= limit.above_factor


def _scale(factor: float | None, what: str) -> str:
    why = "other units, or times" if factor else "all of them are zero, as of a sensor that is not there"
    return f"{factor:.3g} {what}, 1 expected: {why}"


def _position_jump(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    is_reset = any(quality.events.get(name) for name in _RESETS)
    for robot in quality.plausibility:
        found = [jump for jump in robot.jumps if jump.joints < _SEVERAL or not is_reset]
        if found:
            first = min(found, key=lambda jump: jump.at_s)
            total = sum(jump.count for jump in found)
            times = f"; {total} times in all, of {len(found)} joint(s)" if total > 1 else ""
            where = f"by {first.by_rad:.2f} rad at {first.at_s:.2f} s"
            text = f"{first.joint} jumps {where}, which no velocity explains{times}"
            verdict: Verdict = "reject" if total > limits.position_jump.usable_up_to else "usable"
            yield verdict, f"{robot.state_key}: {text}"


def _repeated_states(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.plausibility:
        if robot.moving >= _LEAST_MOVING and robot.repeats.count > limits.repeated_states.above_share * robot.moving:
            first = f"the first at {robot.repeats.first_s or 0.0:.2f} s"
            text = (
                f"{robot.repeats.count} of {robot.moving} states that came while it moved are the one before once more"
            )
            yield "usable", f"{robot.state_key}: {text} ({first}): the sensor is slower than it is told"


def _joint_reversed(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.plausibility:
        if robot.reversed:
            worst = min(robot.reversed, key=robot.reversed.__getitem__)
            more = f"; {len(robot.reversed) - 1} more joint(s)" if len(robot.reversed) > 1 else ""
            text = f"{worst} moves against its command ({robot.reversed[worst]:.2f}, 1 expected): wrong sign{more}"
            yield "reject", f"{robot.state_key}: {text}"


def _joint_offset(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.plausibility:
        joint, off_rad = next(iter(robot.offsets_rad.items()), ("", 0.0))
        if abs(off_rad) > limits.joint_offset.usable_above_rad:
            verdict: Verdict = "reject" if abs(off_rad) > limits.joint_offset.reject_above_rad else "usable"
            text = f"{joint} stays {off_rad:+.2f} rad beside the command that it follows: another zero"
            yield verdict, f"{robot.state_key}: {text}"


def _joint_order(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.plausibility:
        if robot.misplaced:
            first = max(robot.misplaced, key=lambda each: each.other_agreement - each.own_agreement)
            text = f"{first.joint} follows the command of {first.follows} ({first.other_agreement:.2f})"
            own = f"and not its own ({first.own_agreement:.2f})"
            yield "reject", f"{robot.robot}: {text} {own}; {len(robot.misplaced)} joints are out of place"


def _beyond_limits(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.motion:
        beyond, limit = robot.beyond_limit_rad or 0.0, limits.beyond_limits
        if beyond > limit.usable_above_rad:
            verdict: Verdict = "reject" if beyond > limit.reject_above_rad else "usable"
            joint = next(iter(robot.limit_joints), "a joint")
            yield verdict, f"{robot.state_key}: a joint was {beyond:.2f} rad beyond its end, longest {joint}"


def _step_times(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.plausibility:
        times, limit = robot.times, limits.step_times
        if times is None:
            continue
        told = (
            (f"states in {robot.state_key}", times.state_off_s),
            (f"commands in {times.command_key}", times.command_off_s),
        )
        for what, off_s in told:
            if off_s is not None and abs(off_s) > limit.usable_above_s:
                verdict: Verdict = "reject" if abs(off_s) > limit.reject_above_s else "usable"
                how = "later" if off_s > 0 else "earlier"
                steps = f"the steps in {keys.policy_timing(robot.robot)} that used them say"
                yield verdict, f"{what} are stamped {abs(off_s) * 1e3:.0f} ms {how} than {steps}"


def _untimed_steps(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.plausibility:
        times = robot.times
        if times is not None and times.untimed.count > limits.untimed_steps.above_share * times.timed:
            first = f"the first at {times.untimed.first_s or 0.0:.2f} s"
            text = f"{times.untimed.count} of {times.timed} steps tell no instant of their own ({first})"
            yield "usable", f"{keys.policy_timing(robot.robot)}: {text}: their latency is not known"


def _before_written(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.plausibility:
        share = robot.times.before_written_share if robot.times is not None else 0.0
        if share > limits.before_written.above_share:
            text = f"{share:.0%} of the commands were used before they were written"
            yield "usable", f"{keys.policy_timing(robot.robot)}: {text}"


def _command_ahead(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.plausibility:
        if robot.times is not None and robot.times.commands_ahead:
            ahead = robot.times.commands_ahead
            yield "reject", f"{keys.command_used(robot.robot)} holds the command that came {ahead} writes later"


def _reused_states(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.plausibility:
        share, limit = robot.times.reused_states_share if robot.times is not None else 0.0, limits.reused_states
        if share > limit.usable_above_share:
            verdict: Verdict = "reject" if share > limit.reject_above_share else "usable"
            first_s = robot.times.reused_at_s if robot.times is not None else None
            text = (
                f"{share:.1%} of the steps have no state of their own in the file, the first at {first_s or 0.0:.2f} s"
            )
            yield verdict, f"{robot.state_key}: {text}"


def _camera_times(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    limit = limits.camera_times
    for camera in told_apart(quality.cameras):
        p50, p99 = camera.age_p50_s or 0.0, camera.age_p99_s or 0.0
        if camera.ahead_s > limit.ahead_above_s:
            ahead = f"up to {camera.ahead_s * 1e3:.0f} ms before they were taken"
            yield "reject", f"camera {camera.name}: pictures were written {ahead}"
        elif p50 > limit.usable_above_s:
            verdict: Verdict = "reject" if p50 > limit.reject_above_s else "usable"
            yield verdict, f"camera {camera.name}: pictures were {p50 * 1e3:.0f} ms old when they were written (median)"
        elif p99 - p50 > limit.usable_above_s:
            jump = f"jumps between {p50 * 1e3:.0f} ms (p50) and {p99 * 1e3:.0f} ms (p99)"
            yield "usable", f"camera {camera.name}: the age of its pictures {jump}"


def _contract_differs(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    if found := quality.contract_differences:
        first, more = found[0], f"; {len(found) - 1} more key(s)" if len(found) > 1 else ""
        said = f"its robot's server states {first.stated}"
        yield "reject", f"{first.key}: recorded with {first.recorded} as element {first.place}, {said}{more}"


PLAUSIBLE: dict[str, Finder] = {
    "unfit-values": _unfit_values,
    "not-radians": _not_radians,
    "quaternion-norm": _quaternion_norm,
    "frozen-state": _frozen_state,
    "stuck-joint": _stuck_joint,
    "repeated-states": _repeated_states,
    "position-jump": _position_jump,
    "orientation-disagrees": _orientation_disagrees,
    "gyro-scale": _gyro_scale,
    "velocity-disagrees": _velocity_disagrees,
    "velocity-scale": _velocity_scale,
    "joint-order": _joint_order,
    "joint-reversed": _joint_reversed,
    "joint-offset": _joint_offset,
    "beyond-limits": _beyond_limits,
    "step-times": _step_times,
    "untimed-steps": _untimed_steps,
    "before-written": _before_written,
    "command-ahead": _command_ahead,
    "reused-states": _reused_states,
    "camera-times": _camera_times,
    "contract-differs": _contract_differs,
}
"""Those rules by the name that a reason carries."""
