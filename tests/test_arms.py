"""What an arm is to the rest of the station: its command, and what its faults say."""

from __future__ import annotations

import numpy as np
import pytest

from adapters.robots.kassow.names import ARM_7
from station.arms import JointCommand, remedy_of


def test_a_command_keeps_limits_of_its_own_and_leaves_those_that_it_was_given_as_they_are() -> None:
    given = {
        name: np.full(7, value) for name, value in (("lower", 0.5), ("upper", 3.0), ("margin", 0.2), ("rate", 1.0))
    }
    command_format = JointCommand.within("kassow", "kassow_kr810", ARM_7, **given)
    for name, array in given.items():
        array[:] = 9.0  # they are the caller's, who may change them
        kept = getattr(command_format, name)
        assert not (kept == 9.0).any()
        with pytest.raises(ValueError, match="read-only"):
            kept[0] = 9.0
    np.testing.assert_array_equal(command_format.default, np.full(7, 0.5))


@pytest.mark.parametrize(
    ("fault", "remedy"),
    [
        ("safety 1010: torque deviation; when its cause is gone: clear it", "when its cause is gone: clear it"),
        ("lost (no heartbeat; is it on); then: clear it", "then: clear it"),
        ("safety 1010: torque deviation", ""),
        ("", ""),
    ],
)
def test_what_to_do_about_a_fault_stands_after_its_last_semicolon(fault: str, remedy: str) -> None:
    assert remedy_of(fault) == remedy
