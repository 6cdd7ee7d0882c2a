"""Unitree's DDS types, field by field as the robot has them. Needs the extra ``g1``.

Octets are ``types.byte``. With ``types.uint8``, as in Unitree's own Python package, cyclonedds 11 announces a type that
Cyclone 0.10 does not know, and a robot's or a stock program's participant dies of it. Names, order and widths decide
the hash by which two programs know that they speak of the same type (`tests/adapters/robots/g1/dds`).

Source: ``idl/unitree_hg``, ``unitree_go`` and ``unitree_api`` of unitreerobotics/unitree_sdk2_python; of Inspire's
RH56DFTP, ``inspire_sdkpy`` of NaCl-1374/inspire_hand_ws.
"""

from __future__ import annotations

from typing import Any

from cyclonedds.idl import IdlStruct, make_idl_struct, types

_octet = types.byte
_u16, _u32, _i16, _i32, _i64 = types.uint16, types.uint32, types.int16, types.int32, types.int64
_f32, _f64, _array, _sequence = types.float32, types.float64, types.array, types.sequence


def _struct(package: str, name: str, **fields: Any) -> type[IdlStruct]:
    made: type[IdlStruct] = make_idl_struct(name, f"{package}.{name}", fields)
    return made


_HG = "unitree_hg.msg.dds_"

MotorCmd = _struct(
    _HG, "MotorCmd_", mode=_octet, q=_f32, dq=_f32, tau=_f32, kp=_f32, kd=_f32, reserve=_u32
)  # fmt: skip
LowCmd = _struct(
    _HG, "LowCmd_", mode_pr=_octet, mode_machine=_octet, motor_cmd=_array[MotorCmd, 35],
    reserve=_array[_u32, 4], crc=_u32,
)  # fmt: skip
IMUState = _struct(
    _HG, "IMUState_", quaternion=_array[_f32, 4], gyroscope=_array[_f32, 3], accelerometer=_array[_f32, 3],
    rpy=_array[_f32, 3], temperature=_i16,
)  # fmt: skip
MotorState = _struct(
    _HG, "MotorState_", mode=_octet, q=_f32, dq=_f32, ddq=_f32, tau_est=_f32, temperature=_array[_i16, 2], vol=_f32,
    sensor=_array[_u32, 2], motorstate=_u32, reserve=_array[_u32, 4],
)  # fmt: skip
LowState = _struct(
    _HG, "LowState_", version=_array[_u32, 2], mode_pr=_octet, mode_machine=_octet, tick=_u32, imu_state=IMUState,
    motor_state=_array[MotorState, 35], wireless_remote=_array[_octet, 40], reserve=_array[_u32, 4], crc=_u32,
)  # fmt: skip
BmsState = _struct(
    _HG, "BmsState_", version_high=_octet, version_low=_octet, fn=_octet, cell_vol=_array[_u16, 40],
    bmsvoltage=_array[_u32, 3], current=_i32, soc=_octet, soh=_octet, temperature=_array[_i16, 12], cycle=_u16,
    manufacturer_date=_u16, bmsstate=_array[_u32, 5], reserve=_array[_u32, 3],
)  # fmt: skip
HandCmd = _struct(_HG, "HandCmd_", motor_cmd=_sequence[MotorCmd], reserve=_array[_u32, 4])
PressSensorState = _struct(
    _HG, "PressSensorState_", pressure=_array[_f32, 12], temperature=_array[_f32, 12], lost=_u32, reserve=_u32
)
HandState = _struct(
    _HG, "HandState_", motor_state=_sequence[MotorState], press_sensor_state=_sequence[PressSensorState],
    imu_state=IMUState, power_v=_f32, power_a=_f32, system_v=_f32, device_v=_f32, error=_array[_u32, 2],
    reserve=_array[_u32, 2],
)  # fmt: skip

_GO = "unitree_go.msg.dds_"

WirelessController = _struct(_GO, "WirelessController_", lx=_f32, ly=_f32, rx=_f32, ry=_f32, keys=_u16)
GoMotorCmd = _struct(
    _GO, "MotorCmd_", mode=_octet, q=_f32, dq=_f32, tau=_f32, kp=_f32, kd=_f32, reserve=_array[_u32, 3]
)
GoMotorState = _struct(
    _GO, "MotorState_", mode=_octet, q=_f32, dq=_f32, ddq=_f32, tau_est=_f32, q_raw=_f32, dq_raw=_f32, ddq_raw=_f32,
    temperature=_octet, lost=_u32, reserve=_array[_u32, 2],
)  # fmt: skip
MotorCmds = _struct(_GO, "MotorCmds_", cmds=_sequence[GoMotorCmd])
MotorStates = _struct(_GO, "MotorStates_", states=_sequence[GoMotorState])

_six_i16, _six_octets = _sequence[_i16, 6], _sequence[_octet, 6]
InspireCtrl = _struct(
    "inspire", "inspire_hand_ctrl", pos_set=_six_i16, angle_set=_six_i16, force_set=_six_i16, speed_set=_six_i16,
    mode=types.char,  # an int8 on the wire, which Cyclone 0.10 announces as a char
)  # fmt: skip
InspireState = _struct(
    "inspire", "inspire_hand_state", pos_act=_six_i16, angle_act=_six_i16, force_act=_six_i16, current=_six_i16,
    err=_six_octets, status=_six_octets, temperature=_six_octets,
)  # fmt: skip

_API = "unitree_api.msg.dds_"

RequestIdentity = _struct(_API, "RequestIdentity_", id=_i64, api_id=_i64)
RequestLease = _struct(_API, "RequestLease_", id=_i64)
RequestPolicy = _struct(_API, "RequestPolicy_", priority=_i32, noreply=bool)
RequestHeader = _struct(_API, "RequestHeader_", identity=RequestIdentity, lease=RequestLease, policy=RequestPolicy)
Request = _struct(_API, "Request_", header=RequestHeader, parameter=str, binary=_sequence[_octet])
ResponseStatus = _struct(_API, "ResponseStatus_", code=_i32)
ResponseHeader = _struct(_API, "ResponseHeader_", identity=RequestIdentity, status=ResponseStatus)
Response = _struct(_API, "Response_", header=ResponseHeader, data=str, binary=_sequence[_octet])
