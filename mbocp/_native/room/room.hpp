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
    std::vector<Vec3> centers, middles;
};

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

    // Clearance of one pair [m].
    double distance(const Pair& pair, const Placed& placed) const;

    // Clearance of one pair where it is below `near`; something between `near` and the clearance elsewhere [m].
    double distance(const Pair& pair, const Placed& placed, double near) const;

    // Such clearances of all pairs [m].
    void values(const double* q, Placed& placed, double near, double* found) const;

    // Least clearance beyond `lower`, at most `most` [m]; anything below `enough` ends the search for less.
    double least(const double* q, Placed& placed, const double* lower, double most, double enough) const;
};

}  // namespace mbocp
