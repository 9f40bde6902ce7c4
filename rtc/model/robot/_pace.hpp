// The two passes of the pace along a curve. `workers/planning/motion/pace.py` has the same in Python and states the terms.

#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "_kinematics.hpp"

// The greatest value of one unknown that all limits |own x + other y| <= 1 of an interval allow, by the other one.
inline double most_by(const double* own, const double* other, py::ssize_t width, double value, double none) {
    double least = std::numeric_limits<double>::infinity();
    for (py::ssize_t k = 0; k < width; ++k)
        if (!(std::fabs(own[k]) <= none * std::fabs(other[k])))
            least = std::min(least, std::fabs(1 / own[k]) + -other[k] / own[k] * value);
    return least;
}

// The squared pace at each point of a grid, at rest at both ends. `alpha`, `beta` [intervals][limits], `peaks`
// [intervals], `squares` [intervals + 1]: the greatest ones by the other limits. `none`: as `NONE`.
Doubles squared_pace(Doubles alpha, Doubles beta, Doubles peaks, Doubles squares, double none) {
    const py::ssize_t count = peaks.size();
    if (alpha.ndim() != 2 || alpha.shape(0) != count || beta.size() != alpha.size() || squares.size() != count + 1)
        throw std::invalid_argument("limits do not fit the grid");
    const py::ssize_t width = alpha.shape(1);
    std::vector<double> reach(count + 1, 0.0);
    for (py::ssize_t n = count - 1; n >= 0; --n) {
        const double y = std::min(reach[n + 1], peaks.data()[n]);
        reach[n] = std::min(squares.data()[n], most_by(alpha.data(n, 0), beta.data(n, 0), width, y, none));
    }
    Doubles made({count + 1});
    double* found = made.mutable_data();
    found[0] = 0.0;
    for (py::ssize_t n = 0; n < count; ++n) {
        const double most = most_by(beta.data(n, 0), alpha.data(n, 0), width, found[n], none);
        found[n + 1] = std::max(0.0, std::min(reach[n + 1], most));
    }
    return made;
}
