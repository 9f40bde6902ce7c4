// Closed-form inverse kinematics of a PUMA-like arm. `puma_ik.py` has the same in Python and states the terms; its base,
// its tool and its limits are added here, as in `kinematics.py`.

#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>
#include <vector>

#include "_kinematics.hpp"

constexpr double TURN = 2 * 3.14159265358979323846;
constexpr double STRAIGHT = 1e-9;    // sine of joint 5 below which the wrist is straight
constexpr double NO_ANGLE = 0.99999;  // cosine of half the turn of a line, beyond which the sine is nearly 0

class Puma {
   public:
    using Row = std::array<double, 6>;

    // `lengths` [5]: as `PumaGeometry`. `base`, `tool` [4][4]: the world in the axes of the base; the last link in those
    // of the tcp. `speeds` [6] (rad/s).
    Puma(Doubles lengths, Doubles base, Doubles tool, Doubles speeds) {
        if (lengths.size() != 5 || base.size() != 16 || tool.size() != 16) throw std::invalid_argument("not a PUMA");
        d1_ = lengths.data()[0], a2_ = lengths.data()[1], a3_ = lengths.data()[2];
        d3_ = lengths.data()[3], d4_ = lengths.data()[4], forearm_ = std::hypot(a3_, d4_);
        base_ = pose_in(base.data()), tool_ = pose_in(tool.data()), speeds_ = row_of(speeds);
    }

    // The branches nearest to one another at these poses of the tcp (world) [n][7], from `near` on, [n][6] (rad); fewer if
    // one is out of reach.
    Doubles along(Doubles poses, Doubles near) const {
        if (poses.ndim() != 2 || poses.shape(1) != 7) throw std::invalid_argument("a pose has seven values");
        return follow(poses.shape(0), near, [&](py::ssize_t n) { return flange(poses.data(n, 0)); });
    }

    // As `along`, at these fractions of the straight line between two poses; the attitude turns evenly the shorter way.
    Doubles line(Doubles from, Doubles to, Doubles fractions, Doubles near) const {
        if (from.size() != 7 || to.size() != 7) throw std::invalid_argument("a pose has seven values");
        const double *a = from.data(), *b = to.data();
        double cosine = 0.0;
        for (int i = 3; i < 7; ++i) cosine += a[i] * b[i];
        const double angle = std::acos(std::min(std::fabs(cosine), 1.0)), sign = cosine < 0 ? -1.0 : 1.0;
        return follow(fractions.size(), near, [&](py::ssize_t n) {
            double share[2] = {1.0 - fractions.data()[n], fractions.data()[n]}, pose[7], norm = 0.0;
            for (int i = 0; i < 3; ++i) pose[i] = a[i] + share[1] * (b[i] - a[i]);
            if (std::fabs(cosine) <= NO_ANGLE)
                for (double& one : share) one = std::sin(one * angle) / std::sin(angle);
            for (int i = 3; i < 7; ++i) pose[i] = share[0] * a[i] + share[1] * sign * b[i], norm += pose[i] * pose[i];
            for (int i = 3; i < 7; ++i) pose[i] /= std::sqrt(norm);
            return flange(pose);
        });
    }

    // All postures within `least` and `most` [6] (rad) that put the tcp at this pose (world), [n][6]: the ones that are
    // reached soonest from `reference` first.
    Doubles within(Doubles pose, Doubles reference, Doubles least, Doubles most) const {
        if (pose.size() != 7) throw std::invalid_argument("a pose has seven values");
        const Pose at = flange(pose.data());
        const Row from = row_of(reference), low = row_of(least), high = row_of(most);
        std::vector<std::pair<double, Row>> found;
        for (const Shoulder& shoulder : shoulders(at))
            for (const Row& branch : branches(at, shoulder, from[3])) {
                const Row angles = each([&](int k) { return std::remainder(branch[k], TURN); });
                add_turns(angles, 0, Row{}, from, low, high, found);
            }
        std::stable_sort(found.begin(), found.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
        std::vector<Row> rows;
        for (const auto& one : found) rows.push_back(one.second);
        return array(rows);
    }

   private:
    struct Shoulder {
        double q1, u, q3;  // u: horizontal distance of the wrist with its side
    };

    double d1_, a2_, a3_, d3_, d4_, forearm_;
    Pose base_, tool_;
    Row speeds_;

    template <class F>
    static Row each(F value) {
        return {value(0), value(1), value(2), value(3), value(4), value(5)};
    }

    static Row row_of(const Doubles& values) {
        if (values.size() != 6) throw std::invalid_argument("six joints");
        return each([&](int k) { return values.data()[k]; });
    }

    static Doubles array(const std::vector<Row>& rows) {
        Doubles made({static_cast<py::ssize_t>(rows.size()), py::ssize_t{6}});
        for (size_t n = 0; n < rows.size(); ++n) std::copy(rows[n].begin(), rows[n].end(), made.mutable_data(n, 0));
        return made;
    }

    // Frame 6 in frame 0, with the tcp at a pose of the world.
    Pose flange(const double* pose) const {
        const double x = pose[3], y = pose[4], z = pose[5], w = pose[6];
        const Pose tcp{{1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),  //
                        2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),  //
                        2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)},
                       {pose[0], pose[1], pose[2]}};
        return compose(compose(base_, tcp), tool_);
    }

    template <class F>
    Doubles follow(py::ssize_t count, const Doubles& near, F flange_of) const {
        Row now = row_of(near);
        std::vector<Row> rows;
        for (py::ssize_t n = 0; n < count && nearest(flange_of(n), now); ++n) rows.push_back(now);
        return array(rows);
    }

    // Moves `now` to the branch that is reached soonest from it; false: out of reach.
    bool nearest(const Pose& flange, Row& now) const {
        double best_s = std::numeric_limits<double>::infinity();
        Row best;
        for (const Shoulder& shoulder : shoulders(flange))
            for (const Row& branch : branches(flange, shoulder, now[3])) {
                const Row turned = each([&](int k) {
                    const double angle = std::remainder(branch[k], TURN);
                    return angle - TURN * std::nearbyint((angle - now[k]) / TURN);
                });
                const double takes_s = travel_s(turned, now);
                if (takes_s < best_s) best_s = takes_s, best = turned;
            }
        if (best_s == std::numeric_limits<double>::infinity()) return false;
        now = best;
        return true;
    }

    double travel_s(const Row& to, const Row& from) const {
        double most = 0.0;
        for (int k = 0; k < 6; ++k) most = std::max(most, std::fabs(to[k] - from[k]) / speeds_[k]);
        return most;
    }

    std::vector<Shoulder> shoulders(const Pose& flange) const {
        const double x = flange.p[0], y = flange.p[1], z = flange.p[2] - d1_;
        const double radial = x * x + y * y - d3_ * d3_;
        if (radial < 0) return {};
        const double cosine = (radial + z * z - a2_ * a2_ - forearm_ * forearm_) / (2 * a2_ * forearm_);
        if (std::fabs(cosine) > 1) return {};
        const double phase = std::atan2(d4_, a3_), bend = std::acos(cosine), towards = std::atan2(y, x);
        std::vector<Shoulder> found;
        for (const double u : {std::sqrt(radial), -std::sqrt(radial)})
            for (const double q3 : {bend - phase, -bend - phase}) found.push_back({towards - std::atan2(-d3_, u), u, q3});
        return found;
    }

    std::vector<Row> branches(const Pose& flange, const Shoulder& at, double wrist_roll) const {
        const double *x = flange.r, *y = flange.r + 3, *z = flange.r + 6;  // rows of its rotation
        const double c1 = std::cos(at.q1), s1 = std::sin(at.q1), c3 = std::cos(at.q3), s3 = std::sin(at.q3);
        const double q2 = std::atan2(flange.p[2] - d1_, at.u) - std::atan2(a3_ * s3 + d4_ * c3, a2_ + a3_ * c3 - d4_ * s3);
        const double c = std::cos(q2 + at.q3), s = std::sin(q2 + at.q3);
        const auto first = [&](int k) { return c1 * c * x[k] + s1 * c * y[k] + s * z[k]; };
        const auto second = [&](int k) { return -s1 * x[k] + c1 * y[k]; };
        const auto third = [&](int k) { return -c1 * s * x[k] - s1 * s * y[k] + c * z[k]; };
        const double s5 = std::hypot(first(2), second(2)), c5 = third(2);
        if (s5 < STRAIGHT) {
            if (c5 > 0) return {{at.q1, q2, at.q3, wrist_roll, 0.0, std::atan2(second(0), first(0)) - wrist_roll}};
            return {{at.q1, q2, at.q3, wrist_roll, TURN / 2, wrist_roll - std::atan2(second(0), -first(0))}};
        }
        const double q4 = std::atan2(-second(2), -first(2)), q5 = std::atan2(s5, c5), q6 = std::atan2(-third(1), third(0));
        return {{at.q1, q2, at.q3, q4, q5, q6}, {at.q1, q2, at.q3, q4 + TURN / 2, -q5, q6 + TURN / 2}};
    }

    // Adds the posture with each angle from joint `k` on shifted by -1, 0 or 1 turn, as far as the limits allow.
    void add_turns(const Row& angles, int k, Row made, const Row& from, const Row& low, const Row& high,
                   std::vector<std::pair<double, Row>>& found) const {
        if (k == 6) {
            found.emplace_back(travel_s(made, from), made);
            return;
        }
        for (const double angle : {angles[k], angles[k] - TURN, angles[k] + TURN})
            if (low[k] <= angle && angle <= high[k]) {
                made[k] = angle;
                add_turns(angles, k + 1, made, from, low, high, found);
            }
    }
};
