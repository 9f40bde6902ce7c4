// Two arms that both move: whether any posture of one meets any posture of the other, on parts of their ways.
//
// In the middle of both parts a direction separates two boxes by more than the clearance and what both can come nearer
// within their parts. Such a pair is apart in all parts of these parts too, and is not looked at there again.

#pragma once

#include <unordered_map>

#include "_boxes.hpp"

class Separation {
   public:
    // `pairs` [pairs][2]: boxes of the one arm and of the other. `q`: the other values of the configuration. `rows`
    // [n][slots]: the way of each arm. As long as no box is placed anew.
    Separation(Boxes& boxes, Doubles q, Ints pairs, const Slots& slots, Doubles rows, const Slots& their_slots, Doubles their_rows,
               double clearance)
        : boxes_(boxes), q_(q.data(), q.data() + q.size()), clearance_(clearance) {
        sides_[0].slots = slots, sides_[0].rows = rows;
        sides_[1].slots = their_slots, sides_[1].rows = their_rows;
        for (const Side& side : sides_)
            if (side.rows.ndim() != 2 || side.rows.shape(1) != static_cast<py::ssize_t>(side.slots.size()))
                throw std::invalid_argument("rows do not fit the slots");
        const auto pair = pairs.unchecked<2>();
        Open all;
        for (py::ssize_t n = 0; n < pair.shape(0); ++n) {
            pairs_.push_back({sides_[0].index_of(pair(n, 0)), sides_[1].index_of(pair(n, 1))});
            all.push_back(static_cast<int>(n));
        }
        open_.push_back(all);
    }

    // The pairs that are not proven apart while one arm is between these rows and the other between those: the number of
    // their list, or -1 if there is none. `known`: the list of longer parts; 0: all pairs.
    int open(int known, int first, int last, int their_first, int their_last) {
        const Part &one = part(sides_[0], first, last), &other = part(sides_[1], their_first, their_last);
        Open left;
        for (int n : open_.at(known)) {
            const auto [a, b] = pairs_[n];
            const double enough = one.reach[a] + other.reach[b] + clearance_ + ROUNDING_M;
            if (!is_apart(boxes_.solid(sides_[0].boxes[a]), one.at[a], boxes_.solid(sides_[1].boxes[b]), other.at[b], enough, true))
                left.push_back(n);
        }
        if (left.empty()) return -1;
        if (left.size() == open_[known].size()) return known;
        open_.push_back(std::move(left));
        return static_cast<int>(open_.size()) - 1;
    }

   private:
    struct Part {  // of a way, from one row to another
        std::vector<Pose> at;       // of the boxes, in the middle
        std::vector<double> reach;  // how far each of them moves from there at most (m)
    };

    struct Side {
        Slots slots;
        Doubles rows;
        std::vector<int> boxes;
        std::unordered_map<long long, Part> parts;

        int index_of(int box) {
            const auto found = std::find(boxes.begin(), boxes.end(), box);
            if (found != boxes.end()) return static_cast<int>(found - boxes.begin());
            boxes.push_back(box);
            return static_cast<int>(boxes.size()) - 1;
        }
    };

    Boxes& boxes_;
    std::vector<double> q_;
    double clearance_;
    Side sides_[2];
    std::vector<std::pair<int, int>> pairs_;  // by their places in the boxes of each side
    std::vector<Open> open_;

    const Part& part(Side& side, int first, int last) {
        if (first < 0 || last <= first || last >= side.rows.shape(0)) throw std::invalid_argument("no such part of the way");
        Part& found = side.parts[(static_cast<long long>(first) << 32) + last];
        if (!found.at.empty()) return found;
        const size_t width = side.slots.size();
        std::vector<double> turn(width);
        for (size_t k = 0; k < width; ++k) {
            double low = HUGE_VAL, high = -HUGE_VAL;
            for (int n = first; n <= last; ++n) {
                const double value = *side.rows.data(n, k);
                low = std::min(low, value), high = std::max(high, value);
            }
            q_.at(side.slots[k]) = 0.5 * (low + high);
            turn[k] = 0.5 * (high - low);
        }
        found.at = boxes_.places(q_, side.boxes);
        for (int box : side.boxes) {
            double reach = 0.0;
            for (size_t k = 0; k < width; ++k) reach += boxes_.lever(box, side.slots[k]) * turn[k];
            found.reach.push_back(reach);
        }
        return found;
    }
};
