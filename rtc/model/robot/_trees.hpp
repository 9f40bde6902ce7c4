// Two trees of free postures that grow towards each other (RRT-Connect). `workers/planning/motion/sampling.py` has the
// same in Python and states the terms. Here a line counts as free as far as boxes and solids prove it; coal is not asked.

#pragma once

#include <algorithm>
#include <cmath>
#include <optional>
#include <stdexcept>
#include <tuple>
#include <vector>

#include "_boxes.hpp"
#include "_kinematics.hpp"

// Figures of a search; lengths are greatest displacements of a joint (rad), times the joint's weight.
struct Growth {
    double reach, least;         // of an extension: maximum and minimum length
    double back;                 // share of the free part of a blocked line after which its node is set
    double vain;                 // factor of the squared distance of a node from which the tree could not grow
    double projected, onward;    // length of a step between two projections; the share of it that must remain
    double tolerance, damping;   // of a projection
    int projections, halvings;   // maximum number of steps of a projection, and of halvings of a line
};

constexpr double PROBES[] = {0.5, 0.25, 0.75, 0.125, 0.375, 0.625, 0.875};  // shares of a line

// Postures row by row with their parents; roots have the parent -1.
struct Tree {
    std::vector<double> nodes, vain;
    std::vector<int> parents;
    size_t roots = 0;

    int add(const double* q, size_t width, int parent) {
        nodes.insert(nodes.end(), q, q + width);
        vain.push_back(1.0);
        parents.push_back(parent);
        return static_cast<int>(parents.size()) - 1;
    }

    int root(int n) const {
        while (parents[n] >= 0) n = parents[n];
        return n;
    }
};

class Trees {
   public:
    using Row = std::vector<double>;

    // `q` and `slots` as for `Boxes`, whose scene must not change meanwhile. `start` [slots]; `goals` [n][slots]; `limits`
    // [2][slots]; `weights` [2][slots]: of a joint in distances, and its steps of a collision check per rad. `attitude`
    // [9]: of the tip of `arm`, to keep; or empty.
    Trees(Boxes& boxes, Doubles q, Slots slots, Doubles start, Doubles goals, Doubles limits, Doubles weights,
          Growth growth, Arm* arm, Doubles attitude)
        : boxes_(boxes), q_(std::move(q)), slots_(std::move(slots)), width_(slots_.size()), growth_(growth) {
        const auto width = static_cast<py::ssize_t>(width_);
        if (start.size() != width || goals.ndim() != 2 || goals.shape(1) != width || limits.size() != 2 * width ||
            weights.size() != 2 * width || (attitude.size() && (attitude.size() != 9 || !arm)))
            throw std::invalid_argument("values do not fit the slots");
        limits_.assign(limits.data(), limits.data() + limits.size());
        weights_.assign(weights.data(), weights.data() + weights.size());
        attitude_.assign(attitude.data(), attitude.data() + attitude.size());
        arm_ = attitude.size() ? arm : nullptr;
        trees_[0].add(start.data(), width_, -1);
        for (py::ssize_t n = 0; n < goals.shape(0); ++n) trees_[1].add(goals.data(n, 0), width_, -1);
        for (Tree& tree : trees_) tree.roots = tree.parents.size();
    }

    // Whether each end is proven free; the trees cannot grow from another one.
    bool ends_are_free() {
        boxes_.begin(q_, slots_);
        for (const Tree& tree : trees_)
            for (size_t n = 0; n < tree.roots; ++n)
                if (!boxes_.is_free(&tree.nodes[n * width_])) return false;
        return true;
    }

    bool have_grown() const {
        return std::all_of(trees_, trees_ + 2, [](const Tree& tree) { return tree.parents.size() > tree.roots; });
    }

    // Grows towards these samples [n][slots], each tree in turn. None: the trees have not met. Else the number of the
    // sample after which they met, the number of the goal, and the way-points from the start to it.
    std::optional<std::tuple<int, int, std::vector<Doubles>>> grow(Doubles samples) {
        if (samples.ndim() != 2 || samples.shape(1) != static_cast<py::ssize_t>(width_))
            throw std::invalid_argument("samples do not fit the slots");
        boxes_.begin(q_, slots_);
        for (py::ssize_t n = 0; n < samples.shape(0); ++n, first_ = 1 - first_) {
            Row aim(samples.data(n, 0), samples.data(n, 0) + width_);
            const int made = project(aim) ? extend(trees_[first_], aim) : -1;
            if (made < 0) continue;
            const double* node = &trees_[first_].nodes[made * width_];
            const int met = connect(trees_[1 - first_], Row(node, node + width_));
            if (met < 0) continue;
            const int ours = first_ == 0 ? made : met, theirs = first_ == 0 ? met : made;
            return std::make_tuple(static_cast<int>(n), trees_[1].root(theirs), way(ours, theirs));
        }
        return std::nullopt;
    }

    // The postures on the way from one to another, if all of it is free; whether the last one is `there`.
    std::pair<std::vector<Doubles>, bool> steer(Doubles here, Doubles there) {
        if (here.size() != static_cast<py::ssize_t>(width_) || there.size() != here.size())
            throw std::invalid_argument("ends do not fit the slots");
        boxes_.begin(q_, slots_);
        std::vector<Row> reached;
        for (const double share : PROBES)  // a long line may show at once that it is blocked
            if (!arm_ && !boxes_.is_free(between(here.data(), there.data(), share, width_).data())) return {{}, false};
        const bool arrived = steer(Row(here.data(), here.data() + width_), Row(there.data(), there.data() + width_), reached);
        std::vector<Doubles> rows;
        for (const Row& q : reached) rows.push_back(array(q.data()));
        return {rows, arrived};
    }

   private:
    Boxes& boxes_;
    Doubles q_;
    Slots slots_;
    size_t width_;
    Growth growth_;
    Row limits_, weights_, attitude_;
    Arm* arm_;
    Tree trees_[2];  // of the start, of the goals
    int first_ = 0;  // the tree that takes the next sample

    // The greatest displacement between two postures; by the second `weights`: in steps of a collision check.
    double size(const double* a, const double* b, bool steps = false) const {
        const double* weights = weights_.data() + (steps ? width_ : 0);
        double most = 0.0;
        for (size_t k = 0; k < width_; ++k) most = std::max(most, std::fabs(b[k] - a[k]) * weights[k]);
        return most;
    }

    static Row between(const double* a, const double* b, double share, size_t width) {
        Row row(width);
        for (size_t k = 0; k < width; ++k) row[k] = a[k] + share * (b[k] - a[k]);
        return row;
    }

    // Turns a posture to the attitude to keep; false: not found within the limits.
    bool project(Row& q) const {
        if (!arm_) return true;
        if (!arm_->turn(q, attitude_.data(), growth_.projections, growth_.tolerance, growth_.damping)) return false;
        for (size_t k = 0; k < width_; ++k)
            if (q[k] < limits_[k] || q[k] > limits_[width_ + k]) return false;
        return true;
    }

    int nearest(const Tree& tree, const Row& q) const {
        int found = 0;
        double least = HUGE_VAL;
        for (size_t n = 0; n < tree.parents.size(); ++n) {
            double off = 0.0;
            for (size_t k = 0; k < width_; ++k) {
                const double by = (tree.nodes[n * width_ + k] - q[k]) * weights_[k];
                off += by * by;
            }
            if (off * tree.vain[n] < least) least = off * tree.vain[n], found = static_cast<int>(n);
        }
        return found;
    }

    // Grows a tree towards `q` by one extension; the new node, or -1.
    int extend(Tree& tree, Row q) {
        const int near = nearest(tree, q);
        const Row here(&tree.nodes[near * width_], &tree.nodes[near * width_] + width_);
        const double length = size(here.data(), q.data());
        if (length > growth_.reach) {
            q = between(here.data(), q.data(), growth_.reach / length, width_);
            if (!project(q)) return avoid(tree, near);
        }
        std::vector<Row> reached;
        steer(here, q, reached);
        if (reached.empty() || size(here.data(), reached.back().data()) < growth_.least) return avoid(tree, near);
        return add_chain(tree, reached, near);
    }

    // Grows a tree towards `q` as far as the way is free; the node at `q` if it arrives, else -1.
    int connect(Tree& tree, const Row& q) {
        const int near = nearest(tree, q);
        const Row here(&tree.nodes[near * width_], &tree.nodes[near * width_] + width_);
        std::vector<Row> reached;
        if (steer(here, q, reached)) return add_chain(tree, reached, near);
        if (reached.empty() || size(here.data(), reached.back().data()) < growth_.least) return avoid(tree, near);
        add_chain(tree, reached, near);
        return -1;
    }

    // Lets another node be taken for the nearest one sooner.
    int avoid(Tree& tree, int n) {
        tree.vain[n] *= growth_.vain;
        return -1;
    }

    int add_chain(Tree& tree, const std::vector<Row>& chain, int parent) {
        for (const Row& q : chain) parent = tree.add(q.data(), width_, parent);
        return parent;
    }

    // Adds the postures that are reached on the way to `there`; whether the last one is `there`.
    bool steer(const Row& here, const Row& there, std::vector<Row>& reached) {
        if (arm_) return steer_projected(here, there, reached);
        const double share = free_share(here, there);
        if (share > 0.0) reached.push_back(share < 1.0 ? between(here.data(), there.data(), share, width_) : there);
        return share >= 1.0;
    }

    // As `steer`, in short steps, each projected onto the attitude to keep.
    bool steer_projected(Row here, const Row& there, std::vector<Row>& reached) {
        double left = size(here.data(), there.data());
        while (left > growth_.projected) {
            Row step = between(here.data(), there.data(), growth_.projected / left, width_);
            if (!project(step)) return false;
            const double remains = size(step.data(), there.data());
            const bool too_far = size(here.data(), step.data()) > 2 * growth_.projected;
            if (too_far || remains > left - growth_.onward * growth_.projected || free_share(here, step) < 1.0) return false;
            reached.push_back(step);
            here = step, left = remains;
        }
        if (free_share(here, there) < 1.0) return false;
        reached.push_back(there);
        return true;
    }

    // The free share of a line, 0 to 1; of a blocked one up to `back` of its free part.
    double free_share(const Row& here, const Row& there) {
        const int steps = std::max(1, static_cast<int>(std::ceil(size(here.data(), there.data(), true))));
        const double length = std::max(size(here.data(), there.data()), growth_.least);
        // the first node of a line that is blocked here would be nearer than a tree takes
        const int vain = 1 + static_cast<int>(std::min<double>(steps - 1, growth_.least / growth_.back * steps / length));
        const Row early = between(here.data(), there.data(), static_cast<double>(vain) / steps, width_);
        if (!boxes_.is_free(early.data())) return growth_.back * (vain - 1) / steps;
        const int proven = boxes_.along(here.data(), there.data(), steps, growth_.halvings, true).first;
        return proven == steps ? 1.0 : growth_.back * proven / steps;
    }

    std::vector<Doubles> way(int ours, int theirs) const {
        std::vector<Doubles> rows;
        for (int n = ours; n >= 0; n = trees_[0].parents[n]) rows.push_back(row(trees_[0], n));
        std::reverse(rows.begin(), rows.end());
        for (int n = trees_[1].parents[theirs]; n >= 0; n = trees_[1].parents[n]) rows.push_back(row(trees_[1], n));
        return rows;
    }

    Doubles row(const Tree& tree, int n) const { return array(&tree.nodes[n * width_]); }

    Doubles array(const double* q) const { return Doubles(static_cast<py::ssize_t>(width_), q); }
};
