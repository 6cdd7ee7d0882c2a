"""LCM's own library as an independent peer: classes that its generator makes of types as they are published.

The text of the types stands here a second time, in LCM's own language, so that a slip in `adapters.lcm.types` is seen.
"""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from adapters.lcm import types
from adapters.lcm.message import MessageType

TYPES = {
    "homie": """
        struct state_estimator_lcmt { float rpy[3]; float omegaBody[3]; float aBody[3]; float p[3]; float vWorld[3];
            float vBody[3]; float omegaWorld[3]; float quat[4]; float contact_estimate[4]; float aWorld[3];
            int64_t timestamp_us; }
        struct body_control_data_lcmt { float q[29]; float qd[29]; int64_t timestamp_us; }
        struct pd_tau_targets_lcmt { double q_des[29]; double tau_ff[29]; int64_t timestamp_us; }
        struct rc_command_lcmt { int16_t mode; float left_stick[2]; float right_stick[2]; float knobs[2];
            int16_t left_upper_switch; int16_t left_lower_left_switch; int16_t left_lower_right_switch;
            int16_t right_upper_switch; int16_t right_lower_left_switch; int16_t right_lower_right_switch; }
        struct command_lcmt { double command[4]; }
        struct arm_action_lcmt { double act[14]; }
        struct hand_action_lcmt { double act[14]; }
    """,
    "walk_these_ways": """
        struct leg_control_data_lcmt { float q[12]; float qd[12]; float p[12]; float v[12]; float tau_est[12];
            int64_t timestamp_us; int64_t id; int64_t robot_id; }
        struct state_estimator_lcmt { float p[3]; float vWorld[3]; float vBody[3]; float rpy[3]; float omegaBody[3];
            float omegaWorld[3]; float quat[4]; float contact_estimate[4]; float aBody[3]; float aWorld[3];
            int64_t timestamp_us; int64_t id; int64_t robot_id; }
        struct pd_tau_targets_lcmt { double q_des[12]; double qd_des[12]; double tau_ff[12]; double kp[12];
            double kd[12]; int64_t timestamp_us; int64_t id; int64_t robot_id; double se_contactState[4]; }
    """,
}
PACKAGES: dict[str, tuple[MessageType, ...]] = {
    "homie": types.HOMIE,
    "walk_these_ways": tuple(each for each in types.WALK_THESE_WAYS if each is not types.RC_COMMAND),
}


def expect_library() -> Any:
    """Return LCM's library; a machine without it skips, CI fails."""
    try:
        return importlib.import_module("lcm")
    except ImportError:
        message = "LCM's own library is not installed: pip install lcm"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)


def generate(folder: Path) -> None:
    """Have LCM's generator write its classes into a folder, a package for each project."""
    generator = Path(expect_library().LCM_BIN_DIR) / "lcm-gen"
    for package, text in TYPES.items():
        source = folder / f"{package}.lcm"
        source.write_text(f"package {package};\n{text}")
        subprocess.run([generator, "--python", "--ppath", folder, source], check=True, stdout=subprocess.DEVNULL)


def generated(folder: Path, package: str, name: str) -> Any:
    """Return a class that `generate` has written into a folder."""
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    return getattr(importlib.import_module(package), name)


def sample(kind: MessageType) -> dict[str, Any]:
    """Return values of a type, each another number that its primitive type holds exactly."""
    found: dict[str, Any] = {}
    count = 0
    for field in kind.fields:
        numbers = [count + index + 1 for index in range(field.length or 1)]
        count += len(numbers)
        row = tuple(-number / 4 if field.primitive in ("float", "double") else -number for number in numbers)
        found[field.name] = row if field.length else row[0]
    return found
