"""ROS 2's types of a lidar as a Unitree robot's network names them. Needs the extra ``g1``.

Octets are ``types.byte``, as in `adapters.robots.g1.dds.types`, which says why.
Source: ``sensor_msgs``, ``std_msgs``, ``builtin_interfaces`` of unitreerobotics/unitree_sdk2_python.
"""

from __future__ import annotations

from typing import Any

from cyclonedds.idl import IdlStruct, make_idl_struct, types

_octet, _u32, _i32, _f64 = types.byte, types.uint32, types.int32, types.float64
_array, _sequence = types.array, types.sequence


def _struct(package: str, struct: str, **fields: Any) -> type[IdlStruct]:
    made: type[IdlStruct] = make_idl_struct(struct, f"{package}.msg.dds_.{struct}", fields)
    return made


Time = _struct("builtin_interfaces", "Time_", sec=_i32, nanosec=_u32)
Header = _struct("std_msgs", "Header_", stamp=Time, frame_id=str)
PointField = _struct("sensor_msgs", "PointField_", name=str, offset=_u32, datatype=_octet, count=_u32)
PointCloud2 = _struct(
    "sensor_msgs", "PointCloud2_", header=Header, height=_u32, width=_u32, fields=_sequence[PointField],
    is_bigendian=bool, point_step=_u32, row_step=_u32, data=_sequence[_octet], is_dense=bool,
)  # fmt: skip
Quaternion = _struct("geometry_msgs", "Quaternion_", x=_f64, y=_f64, z=_f64, w=_f64)
Vector3 = _struct("geometry_msgs", "Vector3_", x=_f64, y=_f64, z=_f64)
Imu = _struct(
    "sensor_msgs", "Imu_", header=Header, orientation=Quaternion, orientation_covariance=_array[_f64, 9],
    angular_velocity=Vector3, angular_velocity_covariance=_array[_f64, 9], linear_acceleration=Vector3,
    linear_acceleration_covariance=_array[_f64, 9],
)  # fmt: skip
