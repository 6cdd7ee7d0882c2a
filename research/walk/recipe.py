"""What a policy that follows velocities is trained with; the YAML files beside it are the runs that were made."""

from __future__ import annotations

from typing import Literal

from research.recipe import Run


class Recipe(Run, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A training run.

    Attributes:
        robot: Which one learns.
        teacher: Its teacher's network; for the Go2 mujoco_playground's of the Go1, for the G1 FALCON's.
        corrects_per_s: How fast the teacher is asked for more, or less, than the student, while the robot is too slow
            or too fast [1/s]: teachers fall short, drift, and stand still where little is asked.
        stands: Share of the segments of an episode without a velocity.
        arms: Share of a G1's episodes in which its arms move.
    """

    robot: Literal["go2", "g1"] = "go2"
    teacher: str = ""
    corrects_per_s: float = 1.0
    stands: float = 0.2
    arms: float = 0.7
