"""Every key of the station's own, spelled here and nowhere else; those of a robot end in its name.

Keys of stock programs are with the robots that they drive. What a key holds is told by `station.bus.contracts`.
"""

from __future__ import annotations


# -- Any robot's ------------------------------------------------------------------------------------------------------
def action(rest: str) -> str:
    """A command, by the rest of its key: what it commands, and the robot's name."""
    return f"action_{rest}"


def state(rest: str) -> str:
    """A state, likewise."""
    return f"state_{rest}"


# -- Ours, per robot ---------------------------------------------------------------------------------------------
def robot_state(robot: str) -> str:
    """Everything the policy may see of the robot, unscaled."""
    return f"robot_state_{robot}"


def policy_obs(robot: str) -> str:
    """The observation as the network got it."""
    return f"policy_obs_{robot}"


def policy_action(robot: str) -> str:
    """The raw output of the network."""
    return f"policy_action_{robot}"


def policy_timing(robot: str) -> str:
    """When the command of a step was written, arrived, was used, and its targets sent."""
    return f"policy_timing_{robot}"


def target(robot: str) -> str:
    """The joint targets and gains that were really sent."""
    return f"target_{robot}"


def root_velocity(robot: str) -> str:
    """Velocity of the base in its own frame, for a policy that needs it."""
    return f"root_velocity_{robot}"


def sim_qpos(robot: str) -> str:
    """MuJoCo's ground truth."""
    return f"sim_qpos_{robot}"


def command_gate(robot: str) -> str:
    """What the gate did with the command, and why."""
    return f"command_gate_{robot}"


def command_used(robot: str) -> str:
    """The command vector that the policy really got, after the gate."""
    return f"command_used_{robot}"


def command_timing(part: str) -> str:
    """Which command of a part that is commanded apart a step used, and the instant for which its gate decided."""
    return f"command_timing_{part}"


def command_source(robot: str) -> str:
    """Where the command came from: file, hash, frame."""
    return f"command_source_{robot}"


# -- Ours, per arm: a robot of n joints behind a controller of its own ------------------------------------------------
def action_joints(robot: str) -> str:
    """Command of an arm: absolute targets of its n joints [rad], a JSON list in the order of the joints.

    A commander writes it in each of its ticks (up to 250 Hz), moved or not: the age says that it is commanded, the
    numbers say where to. A list equal to the one before costs the controller nothing: only what moved is sent on.
    After 100 ms of silence the arm holds and nothing is sent; after 300 ms the next command is entered anew. Positions
    are absolute and never wrapped: a joint may turn by 360 degrees either way. A commander begins with
    `command_used`, which is where the arm is while no command is followed.
    """
    return f"action_joints_{robot}"


def state_joints(robot: str) -> str:
    """Positions, velocities and torques of an arm's joints, n of each, 125 times a second."""
    return f"state_joints_{robot}"


def state_tcp(robot: str) -> str:
    """Pose of an arm's tool centre point in the frame of its base, 125 times a second."""
    return f"state_tcp_{robot}"


def state_counters(robot: str) -> str:
    """What the real-time session with an arm's controller has counted and measured, 125 times a second.

    Counters only grow; a rate is the difference over a time.
    """
    return f"state_counters_{robot}"


def state_controller(robot: str) -> str:
    """What an arm's controller says of itself: backend, profile, flags, alarm, newest event; ten times a second."""
    return f"state_controller_{robot}"


# -- Ours, per input device: what an operator does, in FLU and SI units, whatever the device --------------------------
def operator_status(device: str) -> str:
    """Whether the device is live, why not, and what its newest sample holds; written every tick."""
    return f"operator_status_{device}"


def operator_controls(device: str) -> str:
    """Buttons, triggers, sticks and keys by name."""
    return f"operator_controls_{device}"


def operator_head(device: str) -> str:
    """Pose of the headset."""
    return f"operator_head_{device}"


def operator_left(device: str) -> str:
    """Pose of the left controller, or of what the left hand holds."""
    return f"operator_left_{device}"


def operator_right(device: str) -> str:
    """Pose of the right controller, or of what the right hand holds."""
    return f"operator_right_{device}"


def operator_body_pos(device: str) -> str:
    """Positions of the operator's 24 body joints."""
    return f"operator_body_pos_{device}"


def operator_body_quat(device: str) -> str:
    """Orientations of the operator's 24 body joints."""
    return f"operator_body_quat_{device}"


def operator_hand_left(device: str) -> str:
    """Poses of the 26 joints of the operator's left hand."""
    return f"operator_hand_left_{device}"


def operator_hand_right(device: str) -> str:
    """Poses of the 26 joints of the operator's right hand."""
    return f"operator_hand_right_{device}"


def operator_twist(device: str) -> str:
    """Deflection of a six-axis device."""
    return f"operator_twist_{device}"


def operator_joints(device: str) -> str:
    """Joint positions of a leader arm."""
    return f"operator_joints_{device}"


# -- Ours, per camera ----------------------------------------------------------------------------------------------
def camera_image(camera: str) -> str:
    """Newest picture of a camera, as a JPEG file."""
    return f"camera_image_{camera}"


def camera_depth(camera: str) -> str:
    """Depth of a camera's newest picture, as a PNG file of 16 bits."""
    return f"camera_depth_{camera}"


# -- Ours, per lidar -----------------------------------------------------------------------------------------------
def lidar_cloud(lidar: str) -> str:
    """Newest point cloud of a lidar, as `station.point_cloud` has it."""
    return f"lidar_cloud_{lidar}"


def lidar_imu(lidar: str) -> str:
    """Newest sample of the IMU in a lidar."""
    return f"lidar_imu_{lidar}"


_BULK = (camera_depth(""), lidar_cloud(""))


def is_bulk(key: str) -> bool:
    """Whether a key, or its stamp, goes over the bulk bus where the station has one: depth and clouds."""
    return key.startswith(_BULK)


# -- Ours, of the station ----------------------------------------------------------------------------------------
ESTOP = "station:estop"
ESTOP_PRESSED = "station:estop:pressed"  # whatever is written here stops: who may press need not be able to release
ARM = "station:arm"
CONTROLLER = "station:controller"
POLICY = "station:policy"
TWIN = "station:twin"
HOST_PREFIX = "station:host:"
LOG_PREFIX = "station:log:"
EVENT = "station:event"
MOTION_CONTROL = "station:motion"
RUNBOOK = "station:runbook"
RUNBOOK_ANSWER = "station:runbook:answer"
RECORD = "station:record"
RECORD_ACK = "station:record:ack"
RECORDER = "station:recorder"
TAP_PROBE = "station:tap:probe"
NOT_MIRRORED = "station:tap:not_mirrored"  # on no bus: in recordings, for each write whose value a tap could not know

_OWN = "station:"  # what they all begin with
SERVER_PREFIX = "station:server:"
CONFIG_PREFIX = "station:config:"
CLOCK_PREFIX = "station:clock:"


def server(name: str) -> str:
    """Health of a server: state, process, rate, jitter."""
    return SERVER_PREFIX + name


def clock(boot: str) -> str:
    """What a machine says of its clock, by its boot."""
    return CLOCK_PREFIX + boot


def host(name: str) -> str:
    """Which servers a station wants on a machine, by its name, and how far each should be."""
    return HOST_PREFIX + name


def log(name: str) -> str:
    """The newest lines that a server printed which the agent of its machine started."""
    return LOG_PREFIX + name


def server_config(name: str) -> str:
    """What a server runs: policy, hashes, gains, rates, code revision."""
    return CONFIG_PREFIX + name


# -- Stamps ------------------------------------------------------------------------------------------------------
def stamp(key: str) -> str:
    """The sibling that holds the stamp of a key's newest write."""
    return key + "@"


def is_bookkeeping(key: str) -> bool:
    """Whether a key is one of the station's own: what servers, recorder and operators say to each other."""
    return key.startswith(_OWN)


def is_stamp(key: str) -> bool:
    """Whether a key is the stamp of another."""
    return key.endswith("@")
