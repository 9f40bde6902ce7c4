// Joints as pinocchio has them, and an arm alone: postures at which its tip has an attitude.

#pragma once

#include <pybind11/numpy.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <stdexcept>
#include <vector>

#include "_solids.hpp"

namespace py = pybind11;

using Doubles = py::array_t<double, py::array::c_style | py::array::forcecast>;
using Ints = py::array_t<int, py::array::c_style | py::array::forcecast>;
using Slots = std::vector<int>;

constexpr double HALF_TURN = 1e-9;    // sine of the angle beside a half turn or none

Pose pose_of(const double* values) {  // twelve: rotation row by row, position
    Pose pose;
    std::copy(values, values + 9, pose.r);
    std::copy(values + 9, values + 12, pose.p);
    return pose;
}

Pose pose_in(const double* matrix) {  // [4][4]
    Pose pose;
    for (int i = 0; i < 3; ++i) {
        std::copy(matrix + 4 * i, matrix + 4 * i + 3, pose.r + 3 * i);
        pose.p[i] = matrix[4 * i + 3];
    }
    return pose;
}

struct Joint {
    int parent;   // number of its parent, or -1
    bool slides;
    double axis[3];
    Pose at;  // in the axes of the parent
};

Pose moved(const Joint& joint, double q) {
    const double x = joint.axis[0], y = joint.axis[1], z = joint.axis[2];
    Pose turn;
    if (joint.slides) {
        const double identity[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
        std::copy(identity, identity + 9, turn.r);
        turn.p[0] = q * x, turn.p[1] = q * y, turn.p[2] = q * z;
        return compose(joint.at, turn);
    }
    const double s = std::sin(q), c = std::cos(q), v = 1.0 - c;
    if (z == 1.0) {  // as most joints: two columns turn
        Pose pose = joint.at;
        for (int i = 0; i < 9; i += 3) {
            pose.r[i] = c * joint.at.r[i] + s * joint.at.r[i + 1];
            pose.r[i + 1] = c * joint.at.r[i + 1] - s * joint.at.r[i];
        }
        return pose;
    }
    const double rotation[9] = {c + x * x * v,     x * y * v - z * s, x * z * v + y * s,
                                y * x * v + z * s, c + y * y * v,     y * z * v - x * s,
                                z * x * v - y * s, z * y * v + x * s, c + z * z * v};
    std::copy(rotation, rotation + 9, turn.r);
    turn.p[0] = turn.p[1] = turn.p[2] = 0.0;
    return compose(joint.at, turn);
}

std::vector<Joint> joints_of(const Ints& parents, const Ints& slides, const Doubles& axes, const Doubles& placements) {
    const auto parent = parents.unchecked<1>();
    const auto slide = slides.unchecked<1>();
    const auto axis = axes.unchecked<2>();
    std::vector<Joint> joints;
    for (py::ssize_t n = 0; n < parent.shape(0); ++n) {
        if (parent(n) >= n) throw std::invalid_argument("a joint stands before its parent");
        joints.push_back({parent(n), slide(n) != 0, {axis(n, 0), axis(n, 1), axis(n, 2)}, pose_of(placements.data(n, 0))});
    }
    return joints;
}

// An arm alone: postures at which its tip has an attitude.
class Arm {
   public:
    // As for `Boxes`. `tip` [12]: placement of the tip in the axes of the last joint.
    Arm(Ints parents, Ints slides, Doubles axes, Doubles placements, Doubles tip)
        : joints_(joints_of(parents, slides, axes, placements)), at_(joints_.size()) {
        if (tip.size() != 12) throw std::invalid_argument("a placement has twelve values");
        tip_ = pose_of(tip.data());
    }

    // A posture near `q` at which the tip has the attitude `goal` [9] within `tolerance` (rad); else none. `damping`: of
    // the steps, which are at most `steps`.
    std::optional<std::vector<double>> turned_to(std::vector<double> q, Doubles goal, int steps, double tolerance, double damping) {
        if (q.size() != joints_.size() || goal.size() != 9) throw std::invalid_argument("values do not fit the joints");
        if (!turn(q, goal.data(), steps, tolerance, damping)) return std::nullopt;
        return q;
    }

    // As `turned_to`, in place; false: not found.
    bool turn(std::vector<double>& q, const double* goal, int steps, double tolerance, double damping) {
        for (int step = 0; step < steps; ++step) {
            const Pose tip = place(q);
            const Vector error = rotation_to(tip.r, goal);
            if (dot(error, error) < tolerance * tolerance) return true;
            add_step(q, tip, error, damping);
        }
        return false;
    }

   private:
    std::vector<Joint> joints_;
    std::vector<Pose> at_;  // of the joints
    Pose tip_;

    Pose place(const std::vector<double>& q) {
        for (size_t n = 0; n < joints_.size(); ++n) {
            const Pose own = moved(joints_[n], q[n]);
            at_[n] = joints_[n].parent < 0 ? own : compose(at_[joints_[n].parent], own);
        }
        return compose(at_.back(), tip_);
    }

    // A damped step of least squares; `error` in the axes of the tip.
    void add_step(std::vector<double>& q, const Pose& tip, Vector error, double damping) const {
        std::vector<Vector> columns(joints_.size(), Vector{0, 0, 0});
        double s[3][3] = {{damping, 0, 0}, {0, damping, 0}, {0, 0, damping}};
        for (int n = static_cast<int>(joints_.size()) - 1; n >= 0; n = joints_[n].parent) {
            if (joints_[n].slides) continue;
            const double *r = at_[n].r, *axis = joints_[n].axis;
            double world[3], c[3];
            for (int i = 0; i < 3; ++i) world[i] = r[3 * i] * axis[0] + r[3 * i + 1] * axis[1] + r[3 * i + 2] * axis[2];
            for (int i = 0; i < 3; ++i) c[i] = tip.r[i] * world[0] + tip.r[3 + i] * world[1] + tip.r[6 + i] * world[2];
            columns[n] = {c[0], c[1], c[2]};
            for (int i = 0; i < 3; ++i)
                for (int j = 0; j < 3; ++j) s[i][j] += c[i] * c[j];
        }
        const Vector x{s[0][0], s[0][1], s[0][2]}, y{s[1][0], s[1][1], s[1][2]}, z{s[2][0], s[2][1], s[2][2]};
        const Vector yz = cross(y, z), zx = cross(z, x), xy = cross(x, y);  // the inverse of a symmetric matrix
        const double size = dot(x, yz);
        const Vector found{dot(yz, error) / size, dot(zx, error) / size, dot(xy, error) / size};
        for (size_t n = 0; n < q.size(); ++n) q[n] += dot(columns[n], found);
    }

    // The rotation vector from one attitude to another, in the axes of the first.
    static Vector rotation_to(const double* from, const double* to) {
        double r[3][3];
        for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j) r[i][j] = from[i] * to[j] + from[3 + i] * to[3 + j] + from[6 + i] * to[6 + j];
        const Vector twice{r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]};
        const double sine = 0.5 * std::sqrt(dot(twice, twice)), cosine = 0.5 * (r[0][0] + r[1][1] + r[2][2] - 1.0);
        const double angle = std::atan2(sine, cosine);
        if (sine > HALF_TURN) return (0.5 * angle / sine) * twice;
        if (cosine > 0.0) return 0.5 * twice;
        int i = 0;  // a half turn: its axis is the longest column of r + 1
        for (int j = 1; j < 3; ++j)
            if (r[j][j] > r[i][i]) i = j;
        Vector axis{r[0][i] + (i == 0), r[1][i] + (i == 1), r[2][i] + (i == 2)};
        return (angle / std::sqrt(dot(axis, axis))) * axis;
    }
};
