// Whether two solids are certainly apart: directions that separate them.
//
// Each solid lies in a box. First 15 directions are tried that may separate the two boxes. Then the solids themselves
// lead to a direction, by the iteration of Gilbert, Johnson and Keerthi. What proves that they are apart is the
// projection of both solids onto the direction, however it was found.

#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

constexpr double PARALLEL = 1e-3;  // sine of the angle of two edges below which their cross product is left out
constexpr int DIRECTIONS = 24;     // that are tried for two solids
constexpr double CORNER = 0.75;    // from the corner of a cube to the ball in it, times its radius
constexpr double BETTER = 1.75;    // times the gap along the best of the 15 directions: two boxes are hardly farther apart
constexpr double TOUCH_M = 1e-7;   // solids as near as this are not proven apart; also the least gain of an iteration

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

// All points of a solid: those of a box or of a hull, added to those of a disk about z, added to those of a ball.
struct Solid {
    double box[3];                 // half edges of the box around it
    double radius, spare;          // of a ball around that box; at most how far it is from the solid at its corners
    double half[3];                // half edges of its own box
    double disk, ball;             // radii
    std::vector<double> points;    // of a hull, instead of a box: x, y, z
};

// A lower bound of the distance of two boxes; the first that exceeds `enough` is returned at once.
inline double gap(const Solid& a, const Pose& pa, const Solid& b, const Pose& pb, double enough) {
    const double d[3] = {pb.p[0] - pa.p[0], pb.p[1] - pa.p[1], pb.p[2] - pa.p[2]};
    const double squared = d[0] * d[0] + d[1] * d[1] + d[2] * d[2], balls = a.radius + b.radius;
    if (squared > (balls + enough) * (balls + enough)) return std::sqrt(squared) - balls;
    double most = -balls;
    double r[3][3], size[3][3], t[3];
    for (int i = 0; i < 3; ++i) {
        t[i] = d[0] * pa.r[i] + d[1] * pa.r[3 + i] + d[2] * pa.r[6 + i];
        double reach = a.box[i];
        for (int j = 0; j < 3; ++j) {
            r[i][j] = pa.r[i] * pb.r[j] + pa.r[3 + i] * pb.r[3 + j] + pa.r[6 + i] * pb.r[6 + j];
            size[i][j] = std::fabs(r[i][j]);
            reach += b.box[j] * size[i][j];
        }
        most = std::max(most, std::fabs(t[i]) - reach);
    }
    if (most > enough) return most;
    for (int j = 0; j < 3; ++j) {
        const double along = std::fabs(t[0] * r[0][j] + t[1] * r[1][j] + t[2] * r[2][j]);
        const double reach =
            b.box[j] + a.box[0] * size[0][j] + a.box[1] * size[1][j] + a.box[2] * size[2][j];
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
            const double reach = a.box[i1] * size[i2][j] + a.box[i2] * size[i1][j] + b.box[j1] * size[i][j2] +
                                 b.box[j2] * size[i][j1];
            most = std::max(most, (along - reach) / length);
        }
    }
    return most;
}

struct Vector {
    double x, y, z;
};

inline Vector operator+(Vector a, Vector b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vector operator-(Vector a, Vector b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vector operator*(double s, Vector a) { return {s * a.x, s * a.y, s * a.z}; }
inline double dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vector cross(Vector a, Vector b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// The farthest point of a solid, without its ball, along a direction of the world.
inline Vector farthest(const Solid& solid, const Pose& at, Vector d) {
    const double* r = at.r;
    const double l[3] = {r[0] * d.x + r[3] * d.y + r[6] * d.z, r[1] * d.x + r[4] * d.y + r[7] * d.z,
                         r[2] * d.x + r[5] * d.y + r[8] * d.z};
    double p[3];
    if (solid.points.empty()) {
        for (int i = 0; i < 3; ++i) p[i] = std::copysign(solid.half[i], l[i]);
    } else {
        const double *points = solid.points.data(), *best = points;
        for (size_t n = 0; n < solid.points.size(); n += 3)
            if ((points[n] - best[0]) * l[0] + (points[n + 1] - best[1]) * l[1] + (points[n + 2] - best[2]) * l[2] > 0)
                best = points + n;
        std::copy(best, best + 3, p);
    }
    if (solid.disk > 0.0) {
        const double across = std::sqrt(l[0] * l[0] + l[1] * l[1]);
        if (across > 0.0) p[0] += solid.disk * l[0] / across, p[1] += solid.disk * l[1] / across;
    }
    return {r[0] * p[0] + r[1] * p[1] + r[2] * p[2] + at.p[0], r[3] * p[0] + r[4] * p[1] + r[5] * p[2] + at.p[1],
            r[6] * p[0] + r[7] * p[1] + r[8] * p[2] + at.p[2]};
}

// The points of a simplex that carry its point nearest to the origin.
struct Simplex {
    Vector points[4] = {};
    int count = 0;
    Vector nearest{0, 0, 0};

    void add(Vector w) { points[count++] = w; }

    void keep(std::initializer_list<Vector> kept, Vector at) {
        count = 0;
        for (const Vector& one : kept) points[count++] = one;
        nearest = at;
    }

    void reduce() {
        const Vector a = points[0], b = points[1], c = points[2], d = points[3];
        if (count == 1) keep({a}, a);
        else if (count == 2) of_line(a, b);
        else if (count == 3) of_triangle(a, b, c);
        else of_faces({{{a, b, c}, d}, {{a, b, d}, c}, {{a, c, d}, b}, {{b, c, d}, a}});
    }

   private:
    struct Face {
        Vector corners[3], other;
    };

    void of_line(Vector a, Vector b) {
        const Vector ab = b - a;
        const double t = -dot(a, ab), whole = dot(ab, ab);
        if (t <= 0.0) keep({a}, a);
        else if (t >= whole) keep({b}, b);
        else keep({a, b}, a + (t / whole) * ab);
    }

    // Ericson, Real-Time Collision Detection, 5.1.5
    void of_triangle(Vector a, Vector b, Vector c) {
        const Vector ab = b - a, ac = c - a;
        const double d1 = -dot(ab, a), d2 = -dot(ac, a), d3 = -dot(ab, b), d4 = -dot(ac, b), d5 = -dot(ab, c),
                     d6 = -dot(ac, c);
        const double va = d3 * d6 - d5 * d4, vb = d5 * d2 - d1 * d6, vc = d1 * d4 - d3 * d2;
        if (d1 <= 0.0 && d2 <= 0.0) keep({a}, a);
        else if (d3 >= 0.0 && d4 <= d3) keep({b}, b);
        else if (d6 >= 0.0 && d5 <= d6) keep({c}, c);
        else if (vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0) of_line(a, b);
        else if (vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0) of_line(a, c);
        else if (va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0) of_line(b, c);
        else keep({a, b, c}, a + (vb / (va + vb + vc)) * ab + (vc / (va + vb + vc)) * ac);
    }

    // The nearest of the faces that have the origin on their outer side; all four points if none has.
    void of_faces(std::initializer_list<Face> faces) {
        Simplex best{};
        double least = HUGE_VAL;
        for (const Face& face : faces) {
            const Vector* p = face.corners;
            const Vector normal = cross(p[1] - p[0], p[2] - p[0]);
            if (dot(normal, p[0]) * dot(normal, p[0] - face.other) > 0.0) continue;
            Simplex one{};
            one.of_triangle(p[0], p[1], p[2]);
            const double squared = dot(one.nearest, one.nearest);
            if (squared < least) least = squared, best = one;
        }
        if (least < HUGE_VAL) *this = best;
    }
};

// Whether a direction is found along which two solids are farther apart than `enough`.
inline bool separates(const Solid& a, const Pose& pa, const Solid& b, const Pose& pb, double enough) {
    enough += a.ball + b.ball;
    Simplex simplex;
    Vector v{pa.p[0] - pb.p[0], pa.p[1] - pb.p[1], pa.p[2] - pb.p[2]};  // a difference of two points of the solids
    for (int n = 0; n < DIRECTIONS; ++n) {
        const double length = std::sqrt(dot(v, v));
        if (length <= enough || length < TOUCH_M) return false;  // v leads from one solid to the other
        const Vector w = farthest(a, pa, -1.0 * v) - farthest(b, pb, v);
        const double apart = dot(v, w) / length;
        if (apart > enough) return true;
        if (length - apart < TOUCH_M) return false;
        if (simplex.count == 4) return false;
        simplex.add(w);
        simplex.reduce();
        if (simplex.count == 4) return false;  // they intersect
        v = simplex.nearest;
    }
    return false;
}

// Sets what follows from the other values.
inline void measure(Solid& solid) {
    solid.radius = std::hypot(solid.box[0], solid.box[1], solid.box[2]);
    solid.spare = solid.points.empty() ? CORNER * (solid.disk + solid.ball) : solid.radius;
}

// Whether two solids are certainly farther apart than `enough` (m). `exact`: try the solids, not only their boxes.
inline bool is_apart(const Solid& a, const Pose& pa, const Solid& b, const Pose& pb, double enough, bool exact) {
    const double found = gap(a, pa, b, pb, enough);
    if (found > enough) return true;
    return exact && BETTER * found + a.spare + b.spare > enough && separates(a, pa, b, pb, enough);
}
