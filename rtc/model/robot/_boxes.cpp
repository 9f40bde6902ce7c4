// Which pairs of bodies of a cell are certainly apart: forward kinematics and separating axes of boxes.
//
// Each piece is represented by a box that contains it. A pair is apart only if one of 15 directions separates the two
// boxes by more than the margin. That is a proof, because the projections of the boxes contain those of the pieces. A
// pair without such a direction is undecided: coal decides it. Placements and pairs come from rtc/model/robot/boxes.py.
//
// A way between two configurations: a pair is apart on all of it if at its middle the gap exceeds the margin by what
// the pair can come nearer until either end (the levers of rtc/model/robot/levers.py). Otherwise the way is halved.

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <stdexcept>
#include <utility>
#include <vector>

namespace py = pybind11;

namespace {

using Doubles = py::array_t<double, py::array::c_style | py::array::forcecast>;
using Ints = py::array_t<int, py::array::c_style | py::array::forcecast>;

constexpr double ROUNDING_M = 1e-5;  // more than the tolerance of coal's iterations and of sums here
constexpr int BLOCK = 16;              // rows of a way that are tested against all pairs at once
constexpr double PARALLEL = 1e-3;    // sine of the angle of two edges below which their cross product is left out

struct Pose {
    double r[9];  // row by row
    double p[3];
};

Pose compose(const Pose& a, const Pose& b) {
    Pose c;
    for (int i = 0; i < 3; ++i) {
        const double *row = a.r + 3 * i;
        for (int j = 0; j < 3; ++j) c.r[3 * i + j] = row[0] * b.r[j] + row[1] * b.r[3 + j] + row[2] * b.r[6 + j];
        c.p[i] = row[0] * b.p[0] + row[1] * b.p[1] + row[2] * b.p[2] + a.p[i];
    }
    return c;
}

Pose pose_of(const double* values) {  // twelve: rotation row by row, position
    Pose pose;
    std::copy(values, values + 9, pose.r);
    std::copy(values + 9, values + 12, pose.p);
    return pose;
}

struct Joint {
    int parent;   // number of its parent, or -1
    bool slides;
    double axis[3];
    Pose at;  // in the axes of the parent
};

struct Box {
    int joint;  // -1: it is fixed in the world
    Pose at;    // in the axes of the joint
    double half[3];
    double radius;
};

struct Pair {
    int number, a, b;
    double margin;
};

using Open = std::vector<int>;  // pairs that are not yet proven apart, by their index in `pairs_`

Pose moved(const Joint& joint, double q) {
    Pose turn;
    const double x = joint.axis[0], y = joint.axis[1], z = joint.axis[2];
    if (joint.slides) {
        const double identity[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
        std::copy(identity, identity + 9, turn.r);
        turn.p[0] = q * x, turn.p[1] = q * y, turn.p[2] = q * z;
    } else {
        const double s = std::sin(q), c = std::cos(q), v = 1.0 - c;
        const double rotation[9] = {c + x * x * v,     x * y * v - z * s, x * z * v + y * s,
                                    y * x * v + z * s, c + y * y * v,     y * z * v - x * s,
                                    z * x * v - y * s, z * y * v + x * s, c + z * z * v};
        std::copy(rotation, rotation + 9, turn.r);
        turn.p[0] = turn.p[1] = turn.p[2] = 0.0;
    }
    return compose(joint.at, turn);
}

// A lower bound of the distance of two boxes; the first that exceeds `enough` is returned at once.
double gap(const Box& a, const Pose& pa, const Box& b, const Pose& pb, double enough) {
    const double d[3] = {pb.p[0] - pa.p[0], pb.p[1] - pa.p[1], pb.p[2] - pa.p[2]};
    const double squared = d[0] * d[0] + d[1] * d[1] + d[2] * d[2], balls = a.radius + b.radius;
    if (squared > (balls + enough) * (balls + enough)) return std::sqrt(squared) - balls;
    double most = -balls;
    double r[3][3], size[3][3], t[3];
    for (int i = 0; i < 3; ++i) {
        t[i] = d[0] * pa.r[i] + d[1] * pa.r[3 + i] + d[2] * pa.r[6 + i];
        double reach = a.half[i];
        for (int j = 0; j < 3; ++j) {
            r[i][j] = pa.r[i] * pb.r[j] + pa.r[3 + i] * pb.r[3 + j] + pa.r[6 + i] * pb.r[6 + j];
            size[i][j] = std::fabs(r[i][j]);
            reach += b.half[j] * size[i][j];
        }
        most = std::max(most, std::fabs(t[i]) - reach);
    }
    if (most > enough) return most;
    for (int j = 0; j < 3; ++j) {
        const double along = std::fabs(t[0] * r[0][j] + t[1] * r[1][j] + t[2] * r[2][j]);
        const double reach =
            b.half[j] + a.half[0] * size[0][j] + a.half[1] * size[1][j] + a.half[2] * size[2][j];
        most = std::max(most, along - reach);
    }
    if (most > enough) return most;
    for (int i = 0; i < 3; ++i) {
        const int i1 = (i + 1) % 3, i2 = (i + 2) % 3;
        for (int j = 0; j < 3; ++j) {
            const double length = std::sqrt(std::max(0.0, 1.0 - r[i][j] * r[i][j]));
            if (length < PARALLEL) continue;
            const int j1 = (j + 1) % 3, j2 = (j + 2) % 3;
            const double along = std::fabs(t[i2] * r[i1][j] - t[i1] * r[i2][j]);
            const double reach = a.half[i1] * size[i2][j] + a.half[i2] * size[i1][j] + b.half[j1] * size[i][j2] +
                                 b.half[j2] * size[i][j1];
            most = std::max(most, (along - reach) / length);
        }
    }
    return most;
}

}  // namespace

class Boxes {
   public:
    // `parents` [joints]: -1 for the world; `slides` [joints]; `axes` [joints][3]; `placements` [joints][12];
    // `halves` [boxes][3] (m); `pairs` [pairs][2]
    Boxes(Ints parents, Ints slides, Doubles axes, Doubles placements, Doubles halves, Ints pairs) {
        const auto parent = parents.unchecked<1>();
        const auto slide = slides.unchecked<1>();
        const auto axis = axes.unchecked<2>();
        const auto half = halves.unchecked<2>();
        const auto pair = pairs.unchecked<2>();
        for (py::ssize_t n = 0; n < parent.shape(0); ++n) {
            if (parent(n) >= n) throw std::invalid_argument("a joint stands before its parent");
            Joint joint{parent(n), slide(n) != 0, {axis(n, 0), axis(n, 1), axis(n, 2)}, pose_of(placements.data(n, 0))};
            joints_.push_back(joint);
        }
        for (py::ssize_t n = 0; n < half.shape(0); ++n) {
            Box box{-1, Pose{{1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}}, {half(n, 0), half(n, 1), half(n, 2)}, 0.0};
            box.radius = std::sqrt(half(n, 0) * half(n, 0) + half(n, 1) * half(n, 1) + half(n, 2) * half(n, 2));
            boxes_.push_back(box);
        }
        for (py::ssize_t n = 0; n < pair.shape(0); ++n) ends_.emplace_back(pair(n, 0), pair(n, 1));
        at_.resize(joints_.size());
        placed_.resize(boxes_.size());
        stamps_.assign(boxes_.size(), 0);
    }

    // Places a box: in the axes of a joint, or in the world (-1).
    void place(int box, int joint, Doubles placement) {
        if (joint >= static_cast<int>(joints_.size())) throw std::invalid_argument("no such joint");
        if (placement.size() != 12) throw std::invalid_argument("a placement has twelve values");
        boxes_.at(box).joint = joint;
        boxes_[box].at = pose_of(placement.data());
    }

    // The pairs to check, by their numbers, with the margin of each (m).
    void use(Ints numbers, Doubles margins) {
        const auto number = numbers.unchecked<1>();
        const auto margin = margins.unchecked<1>();
        pairs_.clear();
        for (py::ssize_t n = 0; n < number.shape(0); ++n) {
            const auto ends = ends_.at(number(n));
            pairs_.push_back({number(n), ends.first, ends.second, std::max(margin(n), 0.0)});
        }
    }

    // The numbers of the pairs that are not certainly apart at this configuration.
    std::vector<int> undecided(Doubles q) {
        if (q.size() != static_cast<py::ssize_t>(joints_.size())) throw std::invalid_argument("a value for each joint");
        move(q.data());
        std::vector<int> found;
        for (const Pair& pair : pairs_)
            if (!is_apart(pair, 0.0)) found.push_back(pair.number);
        return found;
    }

    // The first part of a way that is not proven free: (number of the row before it, its undecided pairs); without
    // such a part (number of the last row, none). `rows` [n][values] of the configuration at `slots`, n > 1;
    // `levers` [pairs of `use`][values].
    std::pair<int, std::vector<int>> way(Doubles q, Ints slots, Doubles rows, Doubles levers, int halvings) {
        q_.assign(q.data(), q.data() + q.size());
        slots_.assign(slots.data(), slots.data() + slots.size());
        rows_ = rows.data();
        levers_ = levers.data();
        if (rows.ndim() != 2 || rows.shape(1) != static_cast<py::ssize_t>(slots_.size()) || rows.shape(0) < 2 ||
            levers.ndim() != 2 || levers.shape(0) != static_cast<py::ssize_t>(pairs_.size()) ||
            levers.shape(1) != rows.shape(1) || q_.size() != joints_.size())
            throw std::invalid_argument("values do not fit the joints, slots and pairs");
        for (int slot : slots_)
            if (slot < 0 || slot >= static_cast<int>(joints_.size())) throw std::invalid_argument("no such joint");
        Open all(pairs_.size());
        for (size_t n = 0; n < all.size(); ++n) all[n] = static_cast<int>(n);
        undecided_.clear();
        const int count = static_cast<int>(rows.shape(0)) - 1;
        for (int first = 0; first < count; first += BLOCK) {
            const int part = over_rows(first, std::min(first + BLOCK, count), all, halvings);
            if (part < 0) continue;
            std::vector<int> numbers;
            for (int one : undecided_) numbers.push_back(pairs_[one].number);
            return {part, numbers};
        }
        return {count, {}};
    }

    // Boxes in the axes of the world around `boxes` on a way, [boxes][6]: low corner, high corner (m). `rows` as for
    // `way`; `levers` [boxes][values]. No point of them moves farther than `step` (m) between two tested configurations.
    Doubles space(Doubles q, Ints slots, Doubles rows, Ints boxes, Doubles levers, double step) {
        const auto slot = slots.unchecked<1>();
        const auto row = rows.unchecked<2>();
        const auto number = boxes.unchecked<1>();
        const auto lever = levers.unchecked<2>();
        const py::ssize_t width = slot.shape(0), count = number.shape(0);
        if (row.shape(1) != width || row.shape(0) < 2 || lever.shape(0) != count || lever.shape(1) != width || step <= 0)
            throw std::invalid_argument("values do not fit the joints, slots and boxes");
        std::vector<double> found(6 * count, HUGE_VAL), near(count), at(q.data(), q.data() + q.size());
        move(at.data());
        std::vector<bool> used(joints_.size());  // the joints that place these boxes; the others need not be moved
        for (py::ssize_t n = 0; n < count; ++n)
            for (int joint = boxes_.at(number(n)).joint; joint >= 0; joint = joints_[joint].parent) used[joint] = true;
        for (py::ssize_t n = 0; n < count; ++n) std::fill_n(&found[6 * n + 3], 3, -HUGE_VAL);
        for (py::ssize_t n = 0; n + 1 < row.shape(0); ++n) {
            double most = 0.0;
            for (py::ssize_t b = 0; b < count; ++b) {
                near[b] = 0.0;
                for (py::ssize_t k = 0; k < width; ++k) near[b] += lever(b, k) * std::fabs(row(n + 1, k) - row(n, k));
                most = std::max(most, near[b]);
            }
            const int parts = std::max(1, static_cast<int>(std::ceil(most / step)));
            for (int part = 0; part < parts; ++part) {
                const double share = (part + 0.5) / parts;
                for (py::ssize_t k = 0; k < width; ++k) at.at(slot(k)) = row(n, k) + share * (row(n + 1, k) - row(n, k));
                move(at.data(), &used);
                for (py::ssize_t b = 0; b < count; ++b) {
                    const Pose& pose = placed(number(b));
                    for (int i = 0; i < 3; ++i) {
                        double reach = 0.5 * near[b] / parts;
                        for (int j = 0; j < 3; ++j) reach += std::fabs(pose.r[3 * i + j]) * boxes_[number(b)].half[j];
                        found[6 * b + i] = std::min(found[6 * b + i], pose.p[i] - reach);
                        found[6 * b + 3 + i] = std::max(found[6 * b + 3 + i], pose.p[i] + reach);
                    }
                }
            }
        }
        Doubles made({count, py::ssize_t{6}});
        std::copy(found.begin(), found.end(), made.mutable_data());
        return made;
    }

   private:
    std::vector<Joint> joints_;
    std::vector<Box> boxes_;
    std::vector<std::pair<int, int>> ends_;
    std::vector<Pair> pairs_;
    std::vector<Pose> at_;      // of the joints, in the world
    std::vector<Pose> placed_;  // of the boxes, in the world, as far as stamped
    std::vector<unsigned> stamps_;
    unsigned stamp_ = 0;
    // of one call of `way`
    std::vector<double> q_;
    std::vector<int> slots_;
    const double* rows_ = nullptr;
    const double* levers_ = nullptr;
    Open undecided_;

    void move(const double* q, const std::vector<bool>* used = nullptr) {
        for (size_t n = 0; n < joints_.size(); ++n) {
            if (used && !(*used)[n]) continue;
            const Pose own = moved(joints_[n], q[n]);
            at_[n] = joints_[n].parent < 0 ? own : compose(at_[joints_[n].parent], own);
        }
        ++stamp_;
    }

    const Pose& placed(int n) {
        if (stamps_[n] != stamp_) {
            const Box& box = boxes_[n];
            placed_[n] = box.joint < 0 ? box.at : compose(at_[box.joint], box.at);
            stamps_[n] = stamp_;
        }
        return placed_[n];
    }

    bool is_apart(const Pair& pair, double nearer) {
        const double enough = pair.margin + nearer + ROUNDING_M;
        return gap(boxes_[pair.a], placed(pair.a), boxes_[pair.b], placed(pair.b), enough) > enough;
    }

    void set_row(const double* row) {
        for (size_t k = 0; k < slots_.size(); ++k) q_[slots_[k]] = row[k];
    }

    // The pairs of `open` that are not proven apart while no value differs from the present ones by more than `turn`.
    Open left(const Open& open, const std::vector<double>& turn) {
        Open kept;
        move(q_.data());
        for (int one : open) {
            const double* lever = levers_ + one * turn.size();
            double nearer = 0.0;
            for (size_t k = 0; k < turn.size(); ++k) nearer += lever[k] * turn[k];
            if (!is_apart(pairs_[one], nearer)) kept.push_back(one);
        }
        return kept;
    }

    // The first part from row `first` to row `last` that is not proven free, with its pairs in `undecided_`; or -1.
    int over_rows(int first, int last, const Open& open, int halvings) {
        const size_t width = slots_.size();
        if (last - first == 1) {
            between(rows_ + first * width, rows_ + last * width, open, halvings);
            return undecided_.empty() ? -1 : first;
        }
        const int middle = (first + last) / 2;
        const double* row = rows_ + middle * width;
        std::vector<double> turn(width, 0.0);
        for (int n = first; n <= last; ++n)
            for (size_t k = 0; k < width; ++k) turn[k] = std::max(turn[k], std::fabs(rows_[n * width + k] - row[k]));
        set_row(row);
        const Open kept = left(open, turn);
        if (kept.empty()) return -1;
        const int part = over_rows(first, middle, kept, halvings);
        return part < 0 ? over_rows(middle, last, kept, halvings) : part;
    }

    // Adds to `undecided_` the pairs that are not proven apart on the straight line between two configurations.
    void between(const double* from, const double* to, const Open& open, int halvings) {
        const size_t width = slots_.size();
        std::vector<double> middle(width), turn(width);
        for (size_t k = 0; k < width; ++k) {
            middle[k] = 0.5 * (from[k] + to[k]);
            turn[k] = 0.5 * std::fabs(to[k] - from[k]);
        }
        set_row(middle.data());
        Open kept = left(open, turn);
        if (halvings > 0) {
            // boxes that are too near in the middle itself are not proven apart by any halving
            const auto hopeless = [this](int one) { return !is_apart(pairs_[one], 0.0); };
            const auto split = std::stable_partition(kept.begin(), kept.end(), std::not_fn(hopeless));
            add(split, kept.end());
            kept.erase(split, kept.end());
            if (kept.empty()) return;
            between(from, middle.data(), kept, halvings - 1);
            between(middle.data(), to, kept, halvings - 1);
            return;
        }
        add(kept.begin(), kept.end());
    }

    void add(Open::const_iterator from, Open::const_iterator to) {
        for (; from != to; ++from)
            if (std::find(undecided_.begin(), undecided_.end(), *from) == undecided_.end()) undecided_.push_back(*from);
    }
};

PYBIND11_MODULE(_boxes, module) {
    py::class_<Boxes>(module, "Boxes")
        .def(py::init<Ints, Ints, Doubles, Doubles, Doubles, Ints>())
        .def("place", &Boxes::place)
        .def("use", &Boxes::use)
        .def("undecided", &Boxes::undecided)
        .def("way", &Boxes::way)
        .def("space", &Boxes::space);
}
