// Where a robot may be: clearances of spheres on its links from shapes, and from each other, at configurations.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

namespace mbocp {

using Vec3 = std::array<double, 3>;
using Mat3 = std::array<double, 9>;  // by rows

struct Pose {
    Mat3 axes;
    Vec3 origin;
};

enum class JointKind : int { screw = 0, circle = 1, planar = 2, floating = 3, ball = 4, translation = 5 };

// A joint: its placement in the parent at rest, and the twist of a unit of its number where it has one.
struct Joint {
    int parent;  // 0: the world
    JointKind kind;
    int first;  // of its numbers in a configuration
    Pose placement;
    Vec3 linear, angular;
};

// A place that carries spheres or shapes: a frame on a joint.
struct Place {
    int joint;
    Pose placement;
};

constexpr int core_size = 5;  // see mbocp.terms.distances

// A pair of a sphere and a shape.
struct Pair {
    int sphere, shape;
    double radius;  // what is subtracted from the distance of centre and core [m]
    double margin;  // the least clearance [m]
    int group;      // of pairs of the same two things
};

// Pairs of a group and a shape, or the points that are shapes at a place, with spheres at one place: all of them are
// far where the balls of these places are.
struct Cluster {
    int place, shape, other, group;  // no shape, -1: the points at the place `other`
    double most;                     // largest radius and margin of them, with what distances are rounded by [m]
    std::vector<int> pairs;          // their numbers
};

// A ball around what is at a place.
struct Ball {
    Vec3 center;
    double radius;
};

struct Sphere {
    int place;
    Vec3 center;
};

struct Shape {
    int place;
    Vec3 middle;
    Mat3 axes;  // columns are the shape's axes
    std::array<double, core_size> core;
    int first_plane, num_planes;  // of a hull; no planes: the shape is its core
    double sharpness;             // see mbocp.terms.distances
    double slope, around;         // a point at r from the middle is at least slope r - around away [m]
};

// A plane that touches a hull, in the axes of the shape, from its middle.
struct Plane {
    Vec3 normal;
    double offset;
};

// Memory of one evaluation.
struct Placed {
    std::vector<Pose> joints, places;
    std::vector<Vec3> centers, middles, balls, points;  // the last two of each place
};

// Of shapes: rounded as in rows, so that distances are smooth, or as they are.
enum class Edges { rounded, sharp };

class Room {
public:
    std::vector<Joint> joints;  // without the world
    std::vector<Place> places;  // without the world
    std::vector<Sphere> spheres;
    std::vector<Shape> shapes;
    std::vector<Plane> planes;
    std::vector<Pair> pairs;
    int nq = 0;

    // Place all joints at a configuration.
    void place_joints(const double* q, Placed& placed) const;

    // Place all spheres and shapes at a configuration.
    void place(const double* q, Placed& placed) const;

    // Gather pairs in clusters, once all tables are there.
    void gather();

    // Clearance of one pair where it is below `near`; something between `near` and the clearance elsewhere [m].
    double distance(const Pair& pair, const Placed& placed, double near, Edges edges = Edges::rounded) const;

    // What no clearance of a cluster's pairs, beyond their margins, is below [m]; above `near` any such number.
    double bound(const Cluster& cluster, const Placed& placed, double near) const;

    // Least clearance beyond the margins of a cluster's pairs, at most `most` [m].
    double least(const Cluster& cluster, const Placed& placed, double most) const;

    // The same of all pairs.
    double least(const Placed& placed, double most) const;

    // Least clearances beyond margins of each group, with sharp edges [m]; above `near` there is something between
    // `near` and these.
    void groups(const Placed& placed, double near, double* found) const;

    // Lower each number of `found` to the pair's clearance beyond its margin, where that is below `near` [m].
    void lower(const Placed& placed, double near, double* found) const;

    std::vector<Cluster> clusters;
    int num_groups = 0;

private:
    std::vector<Ball> balls_, points_;  // around the centres of spheres at each place, the world first, and points

    Vec3 in_axes(const Shape& shape, const Placed& placed, const Vec3& away) const;
    double from_shape(const Shape& shape, const Vec3& p, Edges edges) const;
    double reach(int shape, const Vec3& point, const Placed& placed, double near, double out, Edges edges) const;
};

}  // namespace mbocp
