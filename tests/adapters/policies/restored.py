"""What every policy's memory has to do: go on from what was recorded, and forget when it is reset."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from station.protocols import Floats, Policy, RobotState


def expect_goes_on(policy: Policy, other: Policy, steps: Sequence[tuple[RobotState, Floats]], *, is_run: bool) -> None:
    """Fail unless a policy that is restored two steps before the last one does from there on what the first does.

    Args:
        policy: Does all steps.
        other: Is restored from the observation of one of them, whatever it did before.
        steps: States and commands, three at least.
        is_run: Whether the other infers that observation as well.
    """
    *before, last, after = steps
    for state, command in before:
        observation = policy.observe(state, command)
        action = policy.act(observation)
    other.restore(observation)
    if is_run:
        _expect_same(policy, other, observation, action, command)
    for state, command in (last, after):
        observation = policy.observe(state, command)
        np.testing.assert_array_equal(other.observe(state, command), observation)
        _expect_same(policy, other, observation, policy.act(observation), command)


def _expect_same(policy: Policy, other: Policy, observation: Floats, action: Floats, command: Floats) -> None:
    np.testing.assert_array_equal(other.act(observation), action)
    np.testing.assert_array_equal(other.targets(action, command).q, policy.targets(action, command).q)


def expect_forgets(policy: Policy, steps: Sequence[tuple[RobotState, Floats]]) -> None:
    """Fail unless a policy that was reset observes the first of some steps, four at least, as it did at its start."""
    (state, command), *more = steps
    first = policy.observe(state, command)
    for later in more:
        policy.act(policy.observe(*later))
    policy.reset()
    np.testing.assert_array_equal(policy.observe(state, command), first)
