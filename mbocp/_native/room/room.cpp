#include "room.hpp"

#include <algorithm>
#include <cmath>

namespace mbocp {

namespace {

Vec3 turned(const Mat3& R, const Vec3& p) {
    return {R[0] * p[0] + R[1] * p[1] + R[2] * p[2], R[3] * p[0] + R[4] * p[1] + R[5] * p[2],
            R[6] * p[0] + R[7] * p[1] + R[8] * p[2]};
}

Vec3 turned_back(const Mat3& R, const Vec3& p) {
    return {R[0] * p[0] + R[3] * p[1] + R[6] * p[2], R[1] * p[0] + R[4] * p[1] + R[7] * p[2],
            R[2] * p[0] + R[5] * p[1] + R[8] * p[2]};
}

Vec3 sum(const Vec3& a, const Vec3& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }

Vec3 less(const Vec3& a, const Vec3& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }

double square(const Vec3& a) { return a[0] * a[0] + a[1] * a[1] + a[2] * a[2]; }

Vec3 act(const Pose& pose, const Vec3& p) { return sum(turned(pose.axes, p), pose.origin); }

Pose product(const Pose& a, const Pose& b) {
    Pose c;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            c.axes[3 * i + j] =
                a.axes[3 * i] * b.axes[j] + a.axes[3 * i + 1] * b.axes[3 + j] + a.axes[3 * i + 2] * b.axes[6 + j];
    c.origin = act(a, b.origin);
    return c;
}

const Pose identity{{1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}};

// Rotation about a vector by its length, Rodrigues.
Mat3 rotation(const Vec3& w) {
    const double angle2 = square(w), angle = std::sqrt(angle2);
    const bool is_small = angle < 1e-6;
    const double a = is_small ? 1.0 - angle2 / 6.0 : std::sin(angle) / angle;
    const double half = std::sin(angle / 2.0);
    const double b = is_small ? 0.5 : 2.0 * half * half / angle2;
    const double x = w[0], y = w[1], z = w[2];
    return {1.0 - b * (y * y + z * z), b * x * y - a * z,         b * x * z + a * y,
            b * x * y + a * z,         1.0 - b * (x * x + z * z), b * y * z - a * x,
            b * x * z - a * y,         b * y * z + a * x,         1.0 - b * (x * x + y * y)};
}

Mat3 of_quaternion(const double* q) {
    const double x = q[0], y = q[1], z = q[2], w = q[3];
    return {1 - 2 * (y * y + z * z), 2 * (x * y - z * w),     2 * (x * z + y * w),
            2 * (x * y + z * w),     1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
            2 * (x * z - y * w),     2 * (y * z + x * w),     1 - 2 * (x * x + y * y)};
}

// Twists here have a linear part along the angular one, or none of these: revolute, prismatic, helical.
Pose moved(const Joint& joint, double amount) {
    const Vec3 w{amount * joint.angular[0], amount * joint.angular[1], amount * joint.angular[2]};
    return {rotation(w), {amount * joint.linear[0], amount * joint.linear[1], amount * joint.linear[2]}};
}

Pose motion(const Joint& joint, const double* q) {
    switch (joint.kind) {
    case JointKind::screw:
        return moved(joint, q[0]);
    case JointKind::circle:
        return moved(joint, std::atan2(q[1], q[0]));
    case JointKind::planar:
        return {{q[2], -q[3], 0, q[3], q[2], 0, 0, 0, 1}, {q[0], q[1], 0}};
    case JointKind::floating:
        return {of_quaternion(q + 3), {q[0], q[1], q[2]}};
    case JointKind::ball:
        return {of_quaternion(q), {0, 0, 0}};
    case JointKind::translation:
        return {identity.axes, {q[0], q[1], q[2]}};
    }
    return identity;
}

double positive(double w, double e2) { return (w + std::sqrt(w * w + e2)) / 2.0; }

double largest(double a, double b, double e2) { return (a + b + std::sqrt((a - b) * (a - b) + e2)) / 2.0; }

// mbocp.terms.distances.distance_from_core
double from_core(const Vec3& p, const std::array<double, core_size>& core) {
    const double e2 = core[4] * core[4];
    const double g0 = std::sqrt(p[0] * p[0] + core[3] * p[1] * p[1] + e2) - core[0];
    const double g1 = std::sqrt(p[1] * p[1] + e2) - core[1], g2 = std::sqrt(p[2] * p[2] + e2) - core[2];
    const double s0 = positive(g0, e2), s1 = positive(g1, e2), s2 = positive(g2, e2);
    const double inner = largest(largest(g0, g1, e2), g2, e2);
    return std::sqrt(s0 * s0 + s1 * s1 + s2 * s2) - positive(-inner, e2);
}

// How far a point is beyond the plane of a side. Where that is more than epsilon, the distance is less by less than
// that.
double beyond_sides(const Vec3& p, const std::array<double, core_size>& core) {
    const double across = core[3] == 0.0 ? std::abs(p[0]) : std::sqrt(p[0] * p[0] + core[3] * p[1] * p[1]);
    return std::max({across - core[0], std::abs(p[1]) - core[1], std::abs(p[2]) - core[2]});
}

double dot(const Vec3& a, const Vec3& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// mbocp.terms.distances.hull_measure
double from_planes(const Vec3& p, const Plane* planes, int count, double sharpness) {
    double top = -1e300, sum = 0.0;
    for (int k = 0; k < count; ++k) top = std::max(top, dot(planes[k].normal, p) - planes[k].offset);
    for (int k = 0; k < count; ++k) {
        const double power = sharpness * (dot(planes[k].normal, p) - planes[k].offset - top);
        if (power > -50.0) sum += std::exp(power);  // what is less does not change the sum
    }
    return top + std::log(sum) / sharpness;
}

}  // namespace

void Room::place_joints(const double* q, Placed& placed) const {
    placed.joints.resize(joints.size() + 1);
    placed.joints[0] = identity;
    for (std::size_t j = 0; j < joints.size(); ++j) {
        const Joint& joint = joints[j];
        placed.joints[j + 1] =
            product(placed.joints[joint.parent], product(joint.placement, motion(joint, q + joint.first)));
    }
}

void Room::place(const double* q, Placed& placed) const {
    place_joints(q, placed);
    placed.places.resize(places.size() + 1);
    placed.centers.resize(spheres.size());
    placed.middles.resize(shapes.size());
    placed.places[0] = identity;
    for (std::size_t k = 0; k < places.size(); ++k)
        placed.places[k + 1] = product(placed.joints[places[k].joint], places[k].placement);
    for (std::size_t k = 0; k < spheres.size(); ++k)
        placed.centers[k] = act(placed.places[spheres[k].place], spheres[k].center);
    for (std::size_t k = 0; k < shapes.size(); ++k)
        placed.middles[k] = act(placed.places[shapes[k].place], shapes[k].middle);
}

double Room::distance(const Pair& pair, const Placed& placed) const {
    const Shape& shape = shapes[pair.shape];
    const Vec3 away = less(placed.centers[pair.sphere], placed.middles[pair.shape]);
    const Vec3 local = turned_back(shape.axes, turned_back(placed.places[shape.place].axes, away));
    if (shape.num_planes == 0) return from_core(local, shape.core) - pair.radius;
    return from_planes(local, planes.data() + shape.first_plane, shape.num_planes, shape.sharpness) - pair.radius;
}

double Room::distance(const Pair& pair, const Placed& placed, double near) const {
    const Shape& shape = shapes[pair.shape];
    const Vec3 away = less(placed.centers[pair.sphere], placed.middles[pair.shape]);
    const double least = std::max(shape.around + pair.radius + near, 0.0);
    const double to_middle = shape.slope * shape.slope * square(away);
    if (to_middle > least * least) return std::sqrt(to_middle) - shape.around - pair.radius;
    if (shape.num_planes > 0) return distance(pair, placed);
    const Vec3 p = turned_back(shape.axes, turned_back(placed.places[shape.place].axes, away));
    const double beside = beyond_sides(p, shape.core) - shape.core[4] - pair.radius;
    return beside > std::max(near, 0.0) ? beside : from_core(p, shape.core) - pair.radius;
}

void Room::values(const double* q, Placed& placed, double near, double* found) const {
    place(q, placed);
    for (std::size_t k = 0; k < pairs.size(); ++k) found[k] = distance(pairs[k], placed, near);
}

double Room::least(const double* q, Placed& placed, const double* lower, double most, double enough) const {
    place(q, placed);
    double found = most;
    for (std::size_t k = 0; k < pairs.size(); ++k) {
        const Pair& pair = pairs[k];
        const double away = square(less(placed.centers[pair.sphere], placed.middles[pair.shape]));
        const Shape& shape = shapes[pair.shape];
        const double reach = std::max(shape.around + pair.radius + lower[k] + found, 0.0);
        if (shape.slope * shape.slope * away >= reach * reach) continue;
        found = std::min(found, distance(pair, placed) - lower[k]);
        if (found < enough) return found;
    }
    return found;
}

}  // namespace mbocp
