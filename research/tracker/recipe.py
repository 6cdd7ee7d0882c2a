"""What the tracker is trained with: every number of a run, so that a seed and a file of YAML give it again."""

from __future__ import annotations

import msgspec

from research.recipe import Run

SHARES = {"recorded": 0.30, "gait": 0.24, "builtin": 0.12, "posture": 0.14, "arms": 0.12, "stand": 0.08}
"""How often each kind of streams is drawn."""


class Recipe(Run, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A training run of the tracker.

    Attributes:
        teacher: Checkpoint of TWIST2's family whose actions are the labels.
        calm: How far from home the arms are that the teacher sees, over how far they are; see `research.tracker.tutor`.
        meshed_model: A second robot model for every fourth body, or "".
        motions: Recorded motions that commands are drawn from.
        mirrored: Those of `motions` whose mirror image is drawn from as well; the others' are held back.
        shares: How often each kind of streams is drawn; together 1.
        speeds: Each motion is played at a speed drawn from here.
        made: Number of walks, and of rows of postures, that are made to draw from.
    """

    teacher: str = "twist2:ckpts/twist2_1017_20k.onnx"
    calm: float = 0.25
    meshed_model: str = "twist2:g1/g1_sim2sim_29dof.xml"
    motions: tuple[str, ...] = tuple(f"twist2:motions/0807_yanjie_walk_00{number}.pkl" for number in range(1, 7))
    mirrored: tuple[int, ...] = (1, 2, 4, 5)
    shares: dict[str, float] = msgspec.field(default_factory=lambda: dict(SHARES))
    speeds: tuple[float, ...] = (0.85, 1.0, 1.0, 1.1)
    made: int = 250
