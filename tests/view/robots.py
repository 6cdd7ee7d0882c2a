"""A two-legged thing with every kind of shape, for tests that need no upstream data."""

from __future__ import annotations

from pathlib import Path

TINY = """
<mujoco>
  <asset>
    <mesh name="wedge" vertex="0 0 0  0.1 0 0  0 0.1 0  0 0 0.1"/>
  </asset>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 0.1"/>
    <body name="pelvis" pos="0 0 0.8">
      <freejoint name="root"/>
      <geom type="box" size="0.1 0.2 0.05" rgba="1 0 0 1"/>
      <body name="left_hip" pos="0 0.1 0">
        <joint name="left_hip_pitch_joint" axis="0 1 0"/>
        <geom type="capsule" size="0.05" fromto="0 0 0 0 0 -0.4"/>
        <body name="left_knee" pos="0 0 -0.4">
          <joint name="left_knee_joint" axis="0 1 0"/>
          <geom type="cylinder" size="0.04 0.2" pos="0 0 -0.2"/>
          <geom type="mesh" mesh="wedge" contype="0" conaffinity="0" group="1"/>
        </body>
      </body>
      <body name="head" pos="0 0 0.4">
        <joint name="waist_yaw_joint" axis="0 0 1"/>
        <geom type="sphere" size="0.1"/>
        <geom type="ellipsoid" size="0.1 0.2 0.3"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def tiny(folder: Path) -> Path:
    """Write the model into a folder and return its path."""
    path = folder / "tiny.xml"
    path.write_text(TINY)
    return path
