#include "room.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <tuple>

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

// The distance that this rounds.
double from_sharp_core(const Vec3& p, const std::array<double, core_size>& core) {
    const auto half = [&](double side) { return std::sqrt(std::max(side * side - core[4] * core[4], 0.0)); };
    const double g0 = std::sqrt(p[0] * p[0] + core[3] * p[1] * p[1]) - half(core[0]);
    const double g1 = std::abs(p[1]) - half(core[1]), g2 = std::abs(p[2]) - half(core[2]);
    const double outside = std::sqrt(square({std::max(g0, 0.0), std::max(g1, 0.0), std::max(g2, 0.0)}));
    return outside + std::min(std::max({g0, g1, g2}), 0.0);
}

// How far a point is beyond the plane of a side. Where that is more than epsilon, the distance is less by less than
// that.
double beyond_sides(const Vec3& p, const std::array<double, core_size>& core) {
    const double across = core[3] == 0.0 ? std::abs(p[0]) : std::sqrt(p[0] * p[0] + core[3] * p[1] * p[1]);
    return std::max({across - core[0], std::abs(p[1]) - core[1], std::abs(p[2]) - core[2]});
}

bool is_point(const Shape& shape) { return shape.place > 0 && shape.num_planes == 0 && shape.around == 0.0; }

Ball ball_around(const std::vector<Vec3>& points) {
    Ball found{{0, 0, 0}, 0.0};
    for (const Vec3& point : points)
        for (int i = 0; i < 3; ++i) found.center[i] += point[i] / static_cast<double>(points.size());
    for (const Vec3& point : points)
        found.radius = std::max(found.radius, std::sqrt(square(less(point, found.center))));
    return found;
}

double dot(const Vec3& a, const Vec3& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// mbocp.terms.distances.hull_measure, or the largest distance that it rounds.
double from_planes(const Vec3& p, const Plane* planes, int count, double sharpness, Edges edges) {
    double top = -1e300, sum = 0.0;
    for (int k = 0; k < count; ++k) top = std::max(top, dot(planes[k].normal, p) - planes[k].offset);
    if (edges == Edges::sharp) return top;
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
    for (std::size_t k = 0; k < shapes.size(); ++k) {
        const Shape& shape = shapes[k];
        placed.middles[k] = shape.place == 0 ? shape.middle : act(placed.places[shape.place], shape.middle);
    }
    placed.balls.resize(balls_.size()), placed.points.resize(points_.size());
    for (std::size_t k = 0; k < balls_.size(); ++k) {
        placed.balls[k] = act(placed.places[k], balls_[k].center);
        placed.points[k] = act(placed.places[k], points_[k].center);
    }
}

void Room::gather() {
    std::vector<std::vector<Vec3>> centers(places.size() + 1), points(places.size() + 1);
    for (const Sphere& sphere : spheres) centers[sphere.place].push_back(sphere.center);
    for (const Shape& shape : shapes)
        if (is_point(shape)) points[shape.place].push_back(shape.middle);
    balls_.clear(), points_.clear();
    for (std::size_t k = 0; k <= places.size(); ++k)
        balls_.push_back(ball_around(centers[k])), points_.push_back(ball_around(points[k]));

    std::map<std::tuple<int, int, int, int>, std::size_t> known;
    clusters.clear(), num_groups = 0;
    for (std::size_t k = 0; k < pairs.size(); ++k) {
        const Pair& pair = pairs[k];
        const Shape& shape = shapes[pair.shape];
        const bool has_point = is_point(shape);
        const int place = spheres[pair.sphere].place, number = has_point ? -1 : pair.shape;
        const auto found = known.try_emplace({place, number, shape.place, pair.group}, clusters.size());
        if (found.second)
            clusters.push_back({place, number, shape.place, pair.group, -std::numeric_limits<double>::infinity(), {}});
        Cluster& cluster = clusters[found.first->second];
        cluster.most = std::max(cluster.most, pair.radius + pair.margin + 2.0 * shape.core[4]);
        cluster.pairs.push_back(static_cast<int>(k));
        num_groups = std::max(num_groups, pair.group + 1);
    }
}

Vec3 Room::in_axes(const Shape& shape, const Placed& placed, const Vec3& away) const {
    return turned_back(shape.axes, shape.place == 0 ? away : turned_back(placed.places[shape.place].axes, away));
}

double Room::from_shape(const Shape& shape, const Vec3& p, Edges edges) const {
    if (shape.num_planes == 0) return edges == Edges::sharp ? from_sharp_core(p, shape.core) : from_core(p, shape.core);
    return from_planes(p, planes.data() + shape.first_plane, shape.num_planes, shape.sharpness, edges);
}

// How far a shape is from a point, less `out`, where that is below `near`; else, and with `out` of a ball that has
// more points in it, something between.
double Room::reach(int number, const Vec3& point, const Placed& placed, double near, double out, Edges edges) const {
    const Shape& shape = shapes[number];
    const Vec3 away = less(point, placed.middles[number]);
    const double least = std::max(shape.around + out + near, 0.0), to_middle = shape.slope * shape.slope * square(away);
    if (to_middle > least * least) return std::sqrt(to_middle) - shape.around - out;
    const Vec3 p = in_axes(shape, placed, away);
    if (shape.num_planes == 0) {
        const double beside = beyond_sides(p, shape.core) - shape.core[4] - out;
        if (beside > std::max(near, 0.0)) return beside;
    }
    return from_shape(shape, p, edges) - out;
}

double Room::distance(const Pair& pair, const Placed& placed, double near, Edges edges) const {
    return reach(pair.shape, placed.centers[pair.sphere], placed, near, pair.radius, edges);
}

double Room::bound(const Cluster& cluster, const Placed& placed, double near) const {
    const Vec3& ball = placed.balls[cluster.place];
    const double out = balls_[cluster.place].radius + cluster.most;
    if (cluster.shape >= 0) return reach(cluster.shape, ball, placed, near, out, Edges::sharp);
    return std::sqrt(square(less(ball, placed.points[cluster.other]))) - points_[cluster.other].radius - out;
}

double Room::least(const Cluster& cluster, const Placed& placed, double most) const {
    if (bound(cluster, placed, most) >= most) return most;
    for (int k : cluster.pairs)
        most = std::min(most, distance(pairs[k], placed, most + pairs[k].margin) - pairs[k].margin);
    return most;
}

double Room::least(const Placed& placed, double most) const {
    for (const Cluster& cluster : clusters) most = least(cluster, placed, most);
    return most;
}

void Room::groups(const Placed& placed, double near, double* found) const {
    std::fill(found, found + num_groups, std::numeric_limits<double>::infinity());
    for (const Cluster& cluster : clusters) {
        double& least = found[cluster.group];
        const double far = bound(cluster, placed, near);
        if (far > near || far > least) {
            least = std::min(least, far);
            continue;
        }
        for (int k : cluster.pairs) {
            const double margin = pairs[k].margin;
            least = std::min(least, distance(pairs[k], placed, near + margin, Edges::sharp) - margin);
        }
    }
}

void Room::lower(const Placed& placed, double near, double* found) const {
    for (const Cluster& cluster : clusters) {
        if (bound(cluster, placed, near) > near) continue;
        for (int k : cluster.pairs)
            found[k] = std::min(found[k], distance(pairs[k], placed, near + pairs[k].margin) - pairs[k].margin);
    }
}

}  // namespace mbocp
