#include "kinematics.hpp"

#include <algorithm>
#include <cmath>

namespace kordsim {

namespace {

using V3 = std::array<double, 3>;
using M3 = std::array<double, 9>;

struct Origin {
    V3 offset;  // [m], in the frame of the joint before
    int axis;
};

// Joint origins of the KR810; source: b-robotized/kassow_kord_driver, kr810/urdf/kr810_description.urdf.xacro.
constexpr Origin kOrigins[kJoints] = {
    {{0, 0, 0.035}, 2},           {{0.050, 0, 0.2737}, 1},      {{-0.050, -0.0857, 0.274}, 2}, {{0.040, 0, 0.1429}, 1},
    {{-0.040, 0.08405, 0.271}, 2}, {{0, 0, 0.1035}, 1},          {{0, 0.111, 0.108}, 2},
};

constexpr int kSteps = 20;
constexpr double kDamping = 1e-6, kReached = 1e-7;

V3 turn(const M3& r, const V3& v) {
    return {r[0] * v[0] + r[1] * v[1] + r[2] * v[2], r[3] * v[0] + r[4] * v[1] + r[5] * v[2],
            r[6] * v[0] + r[7] * v[1] + r[8] * v[2]};
}

M3 multiply(const M3& a, const M3& b) {
    M3 out{};
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            for (int k = 0; k < 3; ++k) out[3 * i + j] += a[3 * i + k] * b[3 * k + j];
    return out;
}

M3 transposed(const M3& m) { return {m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]}; }

M3 about(int axis, double angle) {
    const double c = std::cos(angle), s = std::sin(angle);
    if (axis == 0) return {1, 0, 0, 0, c, -s, 0, s, c};
    if (axis == 1) return {c, 0, s, 0, 1, 0, -s, 0, c};
    return {c, -s, 0, s, c, 0, 0, 0, 1};
}

M3 about(const V3& vector) {
    const double angle = std::sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]);
    if (angle < 1e-12) return {1, 0, 0, 0, 1, 0, 0, 0, 1};
    const double x = vector[0] / angle, y = vector[1] / angle, z = vector[2] / angle;
    const double c = std::cos(angle), s = std::sin(angle), v = 1 - c;
    return {c + x * x * v,     x * y * v - z * s, x * z * v + y * s, y * x * v + z * s, c + y * y * v,
            y * z * v - x * s, z * x * v - y * s, z * y * v + x * s, c + z * z * v};
}

V3 cross(const V3& a, const V3& b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

void append(Frame& frame, const Origin& origin, double angle) {
    const V3 shift = turn(frame.r, origin.offset);
    for (int i = 0; i < 3; ++i) frame.p[i] += shift[i];
    frame.r = multiply(frame.r, about(origin.axis, angle));
}

using Jacobian = std::array<std::array<double, kJoints>, 6>;

Jacobian jacobian(const Joints& q, const V3& tool) {
    Jacobian out{};
    Frame frame;
    for (int joint = 0; joint < kJoints; ++joint) {
        append(frame, kOrigins[joint], q[joint]);
        const int a = kOrigins[joint].axis;
        const V3 axis{frame.r[a], frame.r[3 + a], frame.r[6 + a]};
        const V3 linear = cross(axis, {tool[0] - frame.p[0], tool[1] - frame.p[1], tool[2] - frame.p[2]});
        for (int i = 0; i < 3; ++i) {
            out[i][joint] = linear[i];
            out[3 + i][joint] = axis[i];
        }
    }
    return out;
}

// Solves a symmetric positive definite system of six by elimination, in place.
Pose eliminate(std::array<std::array<double, 6>, 6> a, Pose b) {
    for (int i = 0; i < 6; ++i)
        for (int k = i + 1; k < 6; ++k) {
            const double factor = a[k][i] / a[i][i];
            for (int j = i; j < 6; ++j) a[k][j] -= factor * a[i][j];
            b[k] -= factor * b[i];
        }
    for (int i = 5; i >= 0; --i) {
        for (int j = i + 1; j < 6; ++j) b[i] -= a[i][j] * b[j];
        b[i] /= a[i][i];
    }
    return b;
}

void step_towards(Joints& q, const Frame& tool, const Pose& error) {
    const Jacobian j = jacobian(q, tool.p);
    std::array<std::array<double, 6>, 6> jjt{};
    for (int row = 0; row < 6; ++row) {
        for (int column = 0; column < 6; ++column)
            for (int k = 0; k < kJoints; ++k) jjt[row][column] += j[row][k] * j[column][k];
        jjt[row][row] += kDamping;
    }
    const Pose weights = eliminate(jjt, error);
    for (int k = 0; k < kJoints; ++k)
        for (int row = 0; row < 6; ++row) q[k] += j[row][k] * weights[row];
}

}  // namespace

Frame forward(const Joints& q) {
    Frame frame;
    for (int joint = 0; joint < kJoints; ++joint) append(frame, kOrigins[joint], q[joint]);
    return frame;
}

Pose to_pose(const Frame& frame) {
    const M3& r = frame.r;
    const double pitch = std::asin(std::clamp(-r[6], -1.0, 1.0));
    return {frame.p[0], frame.p[1], frame.p[2], std::atan2(r[7], r[8]), pitch, std::atan2(r[3], r[0])};
}

Frame to_frame(const Pose& pose) {
    return {{pose[0], pose[1], pose[2]}, multiply(about(2, pose[5]), multiply(about(1, pose[4]), about(0, pose[3])))};
}

V3 rotation_between(const Frame& from, const Frame& to) {
    const M3 r = multiply(to.r, transposed(from.r));
    const V3 twice{r[7] - r[5], r[2] - r[6], r[3] - r[1]};
    const double sine = 0.5 * std::sqrt(twice[0] * twice[0] + twice[1] * twice[1] + twice[2] * twice[2]);
    const double angle = std::atan2(sine, 0.5 * (r[0] + r[4] + r[8] - 1));
    const double scale = sine > 1e-9 ? 0.5 * angle / sine : 0.5;
    return {twice[0] * scale, twice[1] * scale, twice[2] * scale};
}

Frame between(const Frame& from, const Frame& to, double share) {
    const V3 rotation = rotation_between(from, to);
    Frame out;
    for (int i = 0; i < 3; ++i) out.p[i] = from.p[i] + share * (to.p[i] - from.p[i]);
    out.r = multiply(about({share * rotation[0], share * rotation[1], share * rotation[2]}), from.r);
    return out;
}

bool solve(Joints& q, const Frame& goal) {
    for (int step = 0; step < kSteps; ++step) {
        const Frame tool = forward(q);
        const V3 rotation = rotation_between(tool, goal);
        const Pose error{goal.p[0] - tool.p[0], goal.p[1] - tool.p[1], goal.p[2] - tool.p[2],
                         rotation[0],           rotation[1],           rotation[2]};
        const double size = std::abs(*std::max_element(error.begin(), error.end(), [](double a, double b) {
            return std::abs(a) < std::abs(b);
        }));
        if (size < kReached) return true;
        step_towards(q, tool, error);
    }
    return false;
}

}  // namespace kordsim
