// Made by `python -m adapters.robots.g1.dds.guard_limits`; do not edit.
#ifndef G1_GUARD_LIMITS_H
#define G1_GUARD_LIMITS_H

static const struct joint_limits {
    float lower_rad, upper_rad, speed_rad_s, kp_max, kd_max;
} JOINT_LIMITS[29] = {
    {-2.5307f, 2.8798f, 32.0f, 200.0f, 10.0f},  // left_hip_pitch
    {-0.5236f, 2.9671f, 20.0f, 200.0f, 10.0f},  // left_hip_roll
    {-2.7576f, 2.7576f, 32.0f, 200.0f, 10.0f},  // left_hip_yaw
    {-0.087267f, 2.8798f, 20.0f, 300.0f, 10.0f},  // left_knee
    {-0.87267f, 0.5236f, 37.0f, 100.0f, 10.0f},  // left_ankle_pitch
    {-0.2618f, 0.2618f, 37.0f, 100.0f, 10.0f},  // left_ankle_roll
    {-2.5307f, 2.8798f, 32.0f, 200.0f, 10.0f},  // right_hip_pitch
    {-2.9671f, 0.5236f, 20.0f, 200.0f, 10.0f},  // right_hip_roll
    {-2.7576f, 2.7576f, 32.0f, 200.0f, 10.0f},  // right_hip_yaw
    {-0.087267f, 2.8798f, 20.0f, 300.0f, 10.0f},  // right_knee
    {-0.87267f, 0.5236f, 37.0f, 100.0f, 10.0f},  // right_ankle_pitch
    {-0.2618f, 0.2618f, 37.0f, 100.0f, 10.0f},  // right_ankle_roll
    {-2.618f, 2.618f, 32.0f, 300.0f, 10.0f},  // waist_yaw
    {-0.52f, 0.52f, 37.0f, 300.0f, 10.0f},  // waist_roll
    {-0.52f, 0.52f, 37.0f, 300.0f, 10.0f},  // waist_pitch
    {-3.0892f, 2.6704f, 37.0f, 120.0f, 10.0f},  // left_shoulder_pitch
    {-1.5882f, 2.2515f, 37.0f, 120.0f, 10.0f},  // left_shoulder_roll
    {-2.618f, 2.618f, 37.0f, 120.0f, 10.0f},  // left_shoulder_yaw
    {-1.0472f, 2.0944f, 37.0f, 120.0f, 10.0f},  // left_elbow
    {-1.97222f, 1.97222f, 37.0f, 120.0f, 10.0f},  // left_wrist_roll
    {-1.61443f, 1.61443f, 22.0f, 60.0f, 10.0f},  // left_wrist_pitch
    {-1.61443f, 1.61443f, 22.0f, 60.0f, 10.0f},  // left_wrist_yaw
    {-3.0892f, 2.6704f, 37.0f, 120.0f, 10.0f},  // right_shoulder_pitch
    {-2.2515f, 1.5882f, 37.0f, 120.0f, 10.0f},  // right_shoulder_roll
    {-2.618f, 2.618f, 37.0f, 120.0f, 10.0f},  // right_shoulder_yaw
    {-1.0472f, 2.0944f, 37.0f, 120.0f, 10.0f},  // right_elbow
    {-1.97222f, 1.97222f, 37.0f, 120.0f, 10.0f},  // right_wrist_roll
    {-1.61443f, 1.61443f, 22.0f, 60.0f, 10.0f},  // right_wrist_pitch
    {-1.61443f, 1.61443f, 22.0f, 60.0f, 10.0f},  // right_wrist_yaw
};

#endif
