// Which pairs of bodies of a cell are certainly apart: forward kinematics and separating directions.
//
// A pair is apart only if a direction separates the two pieces, or boxes around them, by more than the margin
// (`_solids.hpp`). A pair without such a direction is undecided: coal decides it. Solids, placements and pairs come from
// rtc/model/robot/boxes.py.
//
// A way between two configurations: a pair is apart on all of it if at its middle the gap exceeds the margin by what
// the pair can come nearer until either end (the levers of rtc/model/robot/levers.py). Otherwise the way is halved.
//
// Boxes that a way does not move are placed once. Boxes in the axes of the world around both sort out most pairs.

#pragma once

#include <algorithm>
#include <cmath>
#include <functional>
#include <stdexcept>
#include <utility>
#include <vector>

#include "_kinematics.hpp"

constexpr double ROUNDING_M = 1e-5;  // more than the tolerance of coal's iterations and of sums here
constexpr int BLOCK = 8;                 // rows of a way that are tested against all pairs at once

struct Box {
    int joint;  // -1: it is fixed in the world
    Pose at;    // in the axes of the joint
    Solid solid;
    std::vector<double> levers;  // of each value of the configuration (m per rad)
};

struct Pair {
    int number, a, b;
    double margin;
};

using Open = std::vector<int>;  // pairs that are not yet proven apart, by their index in `pairs_`

// A box that moves, and around each box that it must keep from but that stands still, a box in the axes of the world,
// larger by the margin of the pair: centre and half edges (m) by axis.
struct Mover {
    int box;
    Open pairs;
    std::vector<double> centre[3], half[3];
    std::vector<double> room;  // between the two along the axis where it is widest, scratch

    void clear() {
        pairs.clear();
        for (int i = 0; i < 3; ++i) centre[i].clear(), half[i].clear();
    }
};

class Boxes {
   public:
    // `parents` [joints]: -1 for the world; `slides` [joints]; `axes` [joints][3]; `placements` [joints][12]; `pairs`
    // [pairs][2]. `solids` [boxes][8]: half edges of the box around it, those of its own box, radii of disk and ball (m);
    // `hulls` [boxes]: the corners of a hull, or none. Each box is to be placed before it is used.
    Boxes(Ints parents, Ints slides, Doubles axes, Doubles placements, Ints pairs, Doubles solids,
          const std::vector<std::vector<double>>& hulls) {
        joints_ = joints_of(parents, slides, axes, placements);
        const auto solid = solids.unchecked<2>();
        const auto pair = pairs.unchecked<2>();
        if (solid.shape(1) != 8 || hulls.size() != static_cast<size_t>(solid.shape(0)))
            throw std::invalid_argument("eight values for each solid, and its hull");
        for (py::ssize_t n = 0; n < solid.shape(0); ++n) {
            Solid made{{solid(n, 0), solid(n, 1), solid(n, 2)}, 0.0, 0.0, {solid(n, 3), solid(n, 4), solid(n, 5)},
                       solid(n, 6), solid(n, 7), hulls[n]};
            measure(made);
            const Pose nowhere{{1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}};
            boxes_.push_back({-1, nowhere, made, std::vector<double>(joints_.size(), 0.0)});
        }
        for (py::ssize_t n = 0; n < pair.shape(0); ++n) ends_.emplace_back(pair(n, 0), pair(n, 1));
        at_.resize(joints_.size());
        placed_.resize(boxes_.size());
        stamps_.assign(boxes_.size(), 0);
    }

    // Places the boxes of an owner, which is at `owner` in the axes of a joint, or in the world (-1). `placements` [n]: in
    // the axes of the owner; both as [4][4]. `levers` [n]: of each value of the configuration.
    void place(const Slots& boxes, int joint, Doubles owner, Doubles placements, Doubles levers) {
        const auto count = static_cast<py::ssize_t>(boxes.size()), width = static_cast<py::ssize_t>(joints_.size());
        if (joint >= width) throw std::invalid_argument("no such joint");
        if (owner.size() != 16 || placements.size() != 16 * count) throw std::invalid_argument("a placement has four rows");
        if (levers.size() != count * width) throw std::invalid_argument("a lever for each joint");
        const Pose at = pose_in(owner.data());
        for (py::ssize_t n = 0; n < count; ++n) {
            Box& box = boxes_.at(boxes[n]);
            box.joint = joint;
            box.at = compose(at, pose_in(placements.data() + 16 * n));
            box.levers.assign(levers.data() + width * n, levers.data() + width * (n + 1));
        }
        sorted_ = false;
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
        sorted_ = false;
    }

    // The numbers of the pairs that are not certainly apart at this configuration. `slots`: the values that vary between
    // one call and the next; it is quicker if the others are as before.
    std::vector<int> undecided(Doubles q, const Slots& slots) {
        begin(q, slots);
        turn_.assign(slots_.size(), 0.0);
        exact_ = true;
        return numbers(all_left());
    }

    // The first part of a way that is not proven free: (number of the row before it, its undecided pairs); without
    // such a part (number of the last row, none). `rows` [n][values] of the configuration at `slots`, n > 1, from the
    // row `from` on. `off` [n - 1][values]: how far the way may be off the straight line between two rows; or empty.
    std::pair<int, std::vector<int>> way(Doubles q, const Slots& slots, Doubles rows, int from, int halvings, Doubles off) {
        begin(q, slots);
        if (rows.ndim() != 2 || rows.shape(1) != static_cast<py::ssize_t>(slots_.size()) || from < 0 ||
            rows.shape(0) < from + 2)
            throw std::invalid_argument("rows do not fit the slots");
        if (off.size() && off.size() != (rows.shape(0) - 1) * rows.shape(1))
            throw std::invalid_argument("a value for each line between two rows");
        rows_ = rows.data();
        off_ = off.size() ? off.data() : nullptr;
        any_ = false;
        return first_open(from, static_cast<int>(rows.shape(0)) - 1, halvings);
    }

    // As `way`, of the straight line between two values at `slots` in `count` equal steps.
    std::pair<int, std::vector<int>> line(Doubles q, const Slots& slots, Doubles from, Doubles to, int count, int halvings) {
        begin(q, slots);
        if (static_cast<size_t>(from.size()) != slots_.size() || static_cast<size_t>(to.size()) != slots_.size() || count < 1)
            throw std::invalid_argument("ends do not fit the slots");
        return along(from.data(), to.data(), count, halvings);
    }

    // Takes over a configuration of which the values at `slots` will change.
    void begin(const Doubles& q, const Slots& slots) {
        if (q.size() != static_cast<py::ssize_t>(joints_.size())) throw std::invalid_argument("a value for each joint");
        const double* values = q.data();
        if (sorted_ && slots == slots_) {
            for (int slot : slots_) q_[slot] = values[slot];
            if (std::equal(q_.begin(), q_.end(), values)) return;
        }
        slots_ = slots;
        for (int slot : slots_)
            if (slot < 0 || slot >= static_cast<int>(joints_.size())) throw std::invalid_argument("no such joint");
        q_.assign(values, values + q.size());
        move(values);
        sort();
    }

    // As `line`, after `begin`. `any`: of the undecided pairs one is enough.
    std::pair<int, std::vector<int>> along(const double* from, const double* to, int count, int halvings, bool any = false) {
        const size_t width = slots_.size();
        line_.resize((count + 1) * width);
        for (int n = 0; n <= count; ++n) {
            const double share = static_cast<double>(n) / count;
            for (size_t k = 0; k < width; ++k) line_[n * width + k] = from[k] + share * (to[k] - from[k]);
        }
        rows_ = line_.data();
        off_ = nullptr;
        any_ = any;
        return first_open(0, count, halvings);
    }

    // Whether no pair is undecided with these values at the slots, after `begin`.
    bool is_free(const double* row) {
        set_row(row);
        turn_.assign(slots_.size(), 0.0);
        exact_ = true;
        return all_left().empty();
    }

    const Solid& solid(int box) const { return boxes_.at(box).solid; }

    double lever(int box, int slot) const { return boxes_.at(box).levers.at(slot); }

    // Where some boxes are at a configuration, in the world.
    std::vector<Pose> places(const std::vector<double>& q, const std::vector<int>& boxes) {
        if (q.size() != joints_.size()) throw std::invalid_argument("a value for each joint");
        sorted_ = false;  // it moves what stands still on a way
        std::vector<char> used(joints_.size());
        for (int box : boxes)
            for (int joint = boxes_.at(box).joint; joint >= 0; joint = joints_[joint].parent) used[joint] = true;
        move(q.data(), &used);
        std::vector<Pose> found;
        for (int box : boxes) found.push_back(placed(box));
        return found;
    }

    // Boxes in the axes of the world around `boxes` on a way, [boxes][6]: low corner, high corner (m). `rows` as for
    // `way`. No point of them moves farther than `step` (m) between two tested configurations.
    Doubles space(Doubles q, Ints slots, Doubles rows, Ints boxes, double step) {
        const auto slot = slots.unchecked<1>();
        const auto row = rows.unchecked<2>();
        const auto number = boxes.unchecked<1>();
        const py::ssize_t width = slot.shape(0), count = number.shape(0);
        if (row.shape(1) != width || row.shape(0) < 2 || step <= 0 || q.size() != static_cast<py::ssize_t>(joints_.size()))
            throw std::invalid_argument("values do not fit the joints, slots and boxes");
        sorted_ = false;  // it moves what stands still on a way
        std::vector<double> found(6 * count, HUGE_VAL), near(count), at(q.data(), q.data() + q.size());
        move(at.data());
        std::vector<char> used(joints_.size());  // the joints that place these boxes; the others need not be moved
        for (py::ssize_t n = 0; n < count; ++n)
            for (int joint = boxes_.at(number(n)).joint; joint >= 0; joint = joints_[joint].parent) used[joint] = true;
        for (py::ssize_t n = 0; n < count; ++n) std::fill_n(&found[6 * n + 3], 3, -HUGE_VAL);
        for (py::ssize_t n = 0; n + 1 < row.shape(0); ++n) {
            double most = 0.0;
            for (py::ssize_t b = 0; b < count; ++b) {
                near[b] = 0.0;
                const std::vector<double>& lever = boxes_[number(b)].levers;
                for (py::ssize_t k = 0; k < width; ++k) near[b] += lever.at(slot(k)) * std::fabs(row(n + 1, k) - row(n, k));
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
                        for (int j = 0; j < 3; ++j) reach += std::fabs(pose.r[3 * i + j]) * boxes_[number(b)].solid.box[j];
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
    // pairs by what moves them, as long as the values at `slots_` alone change
    bool sorted_ = false;
    std::vector<double> q_;
    std::vector<int> slots_;
    std::vector<char> moves_;  // by joint
    std::vector<Mover> movers_;
    Open others_;  // pairs of which both boxes move, or neither; without those that no value at `slots_` brings nearer
    std::vector<double> levers_;  // [pairs][slots], of their distance: none of a joint that moves both boxes
    // of one call
    std::vector<double> turn_;  // greatest difference of the values at `slots_` from the present ones
    bool exact_ = true;  // try the solids too, not only the boxes around them
    const double *rows_ = nullptr, *off_ = nullptr;
    std::vector<double> line_;
    bool any_ = false;  // whether one undecided pair is enough
    Open undecided_;

    void sort() {
        sorted_ = false;
        exact_ = true;
        moves_.assign(joints_.size(), false);
        for (int slot : slots_) moves_[slot] = true;
        for (size_t n = 0; n < joints_.size(); ++n)
            if (joints_[n].parent >= 0 && moves_[joints_[n].parent]) moves_[n] = true;
        std::vector<int> mover_of(boxes_.size(), -1);
        size_t count = 0;
        for (size_t n = 0; n < boxes_.size(); ++n) {
            placed(static_cast<int>(n));
            if (boxes_[n].joint < 0 || !moves_[boxes_[n].joint]) continue;
            mover_of[n] = static_cast<int>(count);
            if (++count > movers_.size()) movers_.emplace_back();
            movers_[count - 1].clear();
            movers_[count - 1].box = static_cast<int>(n);
        }
        movers_.resize(count);
        others_.clear();
        const size_t width = slots_.size();
        std::vector<double> own(boxes_.size() * width), half(boxes_.size() * 3);  // of each box, for all of its pairs
        for (size_t n = 0; n < boxes_.size(); ++n) {
            for (size_t k = 0; k < width; ++k) own[n * width + k] = boxes_[n].levers[slots_[k]];
            for (int i = 0; i < 3; ++i) half[3 * n + i] = half_extent(static_cast<int>(n), i);
        }
        levers_.resize(pairs_.size() * width);
        for (size_t n = 0; n < pairs_.size(); ++n) {
            const Pair& pair = pairs_[n];
            bool rigid = true;
            for (size_t k = 0; k < width; ++k) {
                const double la = own[pair.a * width + k], lb = own[pair.b * width + k];
                const double lever = la == 0.0 || lb == 0.0 ? la + lb : 0.0;
                levers_[n * width + k] = lever;
                rigid = rigid && lever == 0.0;
            }
            const int a = mover_of[pair.a], b = mover_of[pair.b];
            if ((a < 0) == (b < 0)) {
                if (!rigid || !is_apart(pair, 0.0)) others_.push_back(static_cast<int>(n));
                continue;
            }
            Mover& mover = movers_[std::max(a, b)];
            const int other = a < 0 ? pair.a : pair.b;
            mover.pairs.push_back(static_cast<int>(n));
            for (int i = 0; i < 3; ++i) {
                mover.centre[i].push_back(placed_[other].p[i]);
                mover.half[i].push_back(half[3 * other + i] + pair.margin + ROUNDING_M);
            }
        }
        for (Mover& mover : movers_) mover.room.resize(mover.pairs.size());
        sorted_ = true;
    }

    // Half of the length of a placed box along an axis of the world (m).
    double half_extent(int n, int axis) const {
        const double *row = placed_[n].r + 3 * axis, *half = boxes_[n].solid.box;
        return std::fabs(row[0]) * half[0] + std::fabs(row[1]) * half[1] + std::fabs(row[2]) * half[2];
    }

    std::vector<int> numbers(const Open& open) const {
        std::vector<int> found;
        for (int one : open) found.push_back(pairs_[one].number);
        std::sort(found.begin(), found.end());
        return found;
    }

    void move(const double* q, const std::vector<char>* used = nullptr) {
        ++stamp_;
        for (size_t n = 0; n < joints_.size(); ++n) {
            if (used && !(*used)[n]) continue;
            const Pose own = moved(joints_[n], q[n]);
            at_[n] = joints_[n].parent < 0 ? own : compose(at_[joints_[n].parent], own);
        }
    }

    // Where a box is now. Boxes that nothing moves keep the place that `sort` gave them.
    const Pose& placed(int n) {
        const Box& box = boxes_[n];
        if (stamps_[n] != stamp_ && !(sorted_ && (box.joint < 0 || !moves_[box.joint]))) {
            placed_[n] = box.joint < 0 ? box.at : compose(at_[box.joint], box.at);
            stamps_[n] = stamp_;
        }
        return placed_[n];
    }

    bool is_apart(const Pair& pair, double nearer) {
        const double enough = pair.margin + nearer + ROUNDING_M;
        const Solid &a = boxes_[pair.a].solid, &b = boxes_[pair.b].solid;
        const Pose &pa = placed(pair.a), &pb = placed(pair.b);
        return ::is_apart(a, pa, b, pb, enough, exact_);
    }

    // The pairs of `open` that are not proven apart while no value differs from the present ones by more than `turn_`.
    Open left(const Open& open) {
        move(q_.data(), &moves_);
        Open kept;
        const size_t width = slots_.size();
        for (int one : open) {
            const double* lever = &levers_[one * width];
            double nearer = 0.0;
            for (size_t k = 0; k < width; ++k) nearer += lever[k] * turn_[k];
            if (!is_apart(pairs_[one], nearer)) kept.push_back(one);
        }
        return kept;
    }

    // As `left`, of all pairs.
    Open all_left() {
        Open kept = left(others_);
        for (Mover& mover : movers_) {
            const Box& box = boxes_[mover.box];
            const Pose& pose = placed(mover.box);
            double reach = 0.0, half[3];
            for (size_t k = 0; k < slots_.size(); ++k) reach += box.levers[slots_[k]] * turn_[k];
            for (int i = 0; i < 3; ++i) half[i] = half_extent(mover.box, i) + reach;
            const size_t count = mover.pairs.size();
            const double *x = mover.centre[0].data(), *y = mover.centre[1].data(), *z = mover.centre[2].data();
            const double *a = mover.half[0].data(), *b = mover.half[1].data(), *c = mover.half[2].data();
            double* __restrict room = mover.room.data();
            for (size_t n = 0; n < count; ++n)  // without branches or aliases, so that it is compiled to vectors
                room[n] = std::max(std::max(std::fabs(pose.p[0] - x[n]) - a[n] - half[0], std::fabs(pose.p[1] - y[n]) - b[n] - half[1]),
                                   std::fabs(pose.p[2] - z[n]) - c[n] - half[2]);
            for (size_t n = 0; n < count; ++n)
                if (room[n] <= 0.0 && !is_apart(pairs_[mover.pairs[n]], reach)) kept.push_back(mover.pairs[n]);
        }
        return kept;
    }

    void set_row(const double* row) {
        for (size_t k = 0; k < slots_.size(); ++k) q_[slots_[k]] = row[k];
    }

    // The first part between the rows `from` and `last` that is not proven free, as `way` returns it.
    std::pair<int, std::vector<int>> first_open(int from, int last, int halvings) {
        undecided_.clear();
        for (int first = from; first < last; first += BLOCK) {
            const int part = over_rows(first, std::min(first + BLOCK, last), nullptr, halvings);
            if (part >= 0) return {part, numbers(undecided_)};
        }
        return {last, {}};
    }

    // The first part from row `first` to row `last` that is not proven free, with its pairs in `undecided_`; or -1.
    // `open`: the pairs that are not yet proven apart there; nullptr: all.
    int over_rows(int first, int last, const Open* open, int halvings) {
        const size_t width = slots_.size();
        if (last - first == 1) {
            between(first, rows_ + first * width, rows_ + last * width, open, halvings);
            return undecided_.empty() ? -1 : first;
        }
        const int middle = (first + last) / 2;
        const double* row = rows_ + middle * width;
        turn_.assign(width, 0.0);
        for (int n = first; n <= last; ++n)
            for (size_t k = 0; k < width; ++k) turn_[k] = std::max(turn_[k], std::fabs(rows_[n * width + k] - row[k]));
        if (off_) {
            std::vector<double> most(width, 0.0);
            for (int n = first; n < last; ++n)
                for (size_t k = 0; k < width; ++k) most[k] = std::max(most[k], off_[n * width + k]);
            for (size_t k = 0; k < width; ++k) turn_[k] += most[k];
        }
        set_row(row);
        exact_ = false;  // on so long a way the solids prove little more
        const Open kept = open ? left(*open) : all_left();
        if (kept.empty()) return -1;
        const int part = over_rows(first, middle, &kept, halvings);
        return part < 0 ? over_rows(middle, last, &kept, halvings) : part;
    }

    // Adds to `undecided_` the pairs that are not proven apart between two configurations of the line behind row `n`.
    void between(int n, const double* from, const double* to, const Open* open, int halvings) {
        const size_t width = slots_.size();
        std::vector<double> middle(width);
        turn_.resize(width);
        for (size_t k = 0; k < width; ++k) {
            middle[k] = 0.5 * (from[k] + to[k]);
            turn_[k] = 0.5 * std::fabs(to[k] - from[k]) + (off_ ? off_[n * width + k] : 0.0);
        }
        set_row(middle.data());
        exact_ = true;
        Open kept = open ? left(*open) : all_left();
        if (halvings > 0) {
            // boxes that are too near in the middle itself are not proven apart by any halving
            const auto hopeless = [this](int one) { return !is_apart(pairs_[one], 0.0); };
            const auto split = std::stable_partition(kept.begin(), kept.end(), std::not_fn(hopeless));
            add(split, kept.end());
            kept.erase(split, kept.end());
            if (kept.empty() || is_enough()) return;
            between(n, from, middle.data(), &kept, halvings - 1);
            if (is_enough()) return;
            between(n, middle.data(), to, &kept, halvings - 1);
            return;
        }
        add(kept.begin(), kept.end());
    }

    bool is_enough() const { return any_ && !undecided_.empty(); }

    void add(Open::const_iterator from, Open::const_iterator to) {
        for (; from != to; ++from)
            if (std::find(undecided_.begin(), undecided_.end(), *from) == undecided_.end()) undecided_.push_back(*from);
    }
};
