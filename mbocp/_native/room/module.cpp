// Python's view of a room: tables in, arrays out, all of one dimension.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <limits>
#include <stdexcept>
#include <string>

#include "room.hpp"
#include "search.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace mbocp {

namespace {

using Input = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Output = nb::ndarray<nb::numpy, double, nb::ndim<1>>;

constexpr int joint_size = 21, place_size = 13, sphere_size = 4, shape_size = 23, plane_size = 4, pair_size = 5;

Output array_of(const std::vector<double>& values) {
    auto* data = new double[values.size() + 1];
    std::copy(values.begin(), values.end(), data);
    nb::capsule owner(data, [](void* p) noexcept { delete[] static_cast<double*>(p); });
    return Output(data, {values.size()}, owner);
}

void check(bool is_right, const char* what) {
    if (!is_right) throw std::invalid_argument(what);
}

template <std::size_t N>
std::array<double, N> part(const double* row, int first) {
    std::array<double, N> found;
    std::copy(row + first, row + first + N, found.begin());
    return found;
}

Pose pose_of(const double* row, int first) { return {part<9>(row, first), part<3>(row, first + 9)}; }

// Rows of a table, and a number of theirs that has to be an index below a count.
struct Rows {
    const double* data;
    std::size_t count;
    int size;

    Rows(const Input& table, int row, const char* what) : data(table.data()), count(table.size() / row), size(row) {
        check(table.size() % static_cast<std::size_t>(row) == 0, what);
    }
    const double* operator[](std::size_t k) const { return data + k * static_cast<std::size_t>(size); }
};

int index(double value, std::size_t count) {
    check(value >= 0.0 && value < static_cast<double>(count), "an index of a table is out of range");
    return static_cast<int>(value);
}

Room made(int nq, const Input& joints, const Input& places, const Input& spheres, const Input& shapes,
          const Input& planes, const Input& pairs) {
    Room room;
    room.nq = nq;
    static const int numbers[] = {1, 2, 4, 7, 4, 3};
    const Rows of_joints(joints, joint_size, "joints: the table has no whole rows");
    for (std::size_t k = 0; k < of_joints.count; ++k) {
        const double* row = of_joints[k];
        const int kind = index(row[1], 6);
        const int last = static_cast<int>(row[2]) + numbers[kind];
        check(row[2] >= 0.0 && last <= nq, "joints: numbers beyond the configuration");
        room.joints.push_back({index(row[0], k + 1), static_cast<JointKind>(kind), static_cast<int>(row[2]),
                               pose_of(row, 3), part<3>(row, 15), part<3>(row, 18)});
    }
    const Rows of_places(places, place_size, "places: the table has no whole rows");
    for (std::size_t k = 0; k < of_places.count; ++k)
        room.places.push_back({index(of_places[k][0], room.joints.size() + 1), pose_of(of_places[k], 1)});
    const Rows of_spheres(spheres, sphere_size, "spheres: the table has no whole rows");
    for (std::size_t k = 0; k < of_spheres.count; ++k)
        room.spheres.push_back({index(of_spheres[k][0], room.places.size() + 1), part<3>(of_spheres[k], 1)});
    const Rows of_planes(planes, plane_size, "planes: the table has no whole rows");
    for (std::size_t k = 0; k < of_planes.count; ++k)
        room.planes.push_back({part<3>(of_planes[k], 0), of_planes[k][3]});
    const Rows of_shapes(shapes, shape_size, "shapes: the table has no whole rows");
    for (std::size_t k = 0; k < of_shapes.count; ++k) {
        const double* row = of_shapes[k];
        room.shapes.push_back({index(row[0], room.places.size() + 1), part<3>(row, 1), part<9>(row, 4),
                               part<core_size>(row, 13), index(row[18], room.planes.size() + 1),
                               index(row[19], room.planes.size() + 1), row[20], row[21], row[22]});
        const Shape& shape = room.shapes.back();
        check(shape.first_plane + shape.num_planes <= static_cast<int>(room.planes.size()), "planes: too few");
    }
    constexpr std::size_t most = std::numeric_limits<int>::max();
    const Rows of_pairs(pairs, pair_size, "pairs: the table has no whole rows");
    for (std::size_t k = 0; k < of_pairs.count; ++k) {
        const double* row = of_pairs[k];
        room.pairs.push_back({index(row[0], room.spheres.size()), index(row[1], room.shapes.size()), row[2], row[3],
                              index(row[4], most)});
    }
    room.gather();
    return room;
}

std::size_t count_of(const Room& room, const Input& qs) {
    check(room.nq > 0 && qs.size() % static_cast<std::size_t>(room.nq) == 0, "qs: no whole configurations");
    return qs.size() / static_cast<std::size_t>(room.nq);
}

// What a function makes of each configuration, `width` numbers of each, as it finds them in `found`.
template <typename F>
Output of_each(const Room& room, const Input& qs, std::size_t width, F&& function) {
    const std::size_t count = count_of(room, qs);
    std::vector<double> found(count * width);
    {
        nb::gil_scoped_release released;
        Placed placed;
        for (std::size_t k = 0; k < count; ++k) {
            room.place(qs.data() + k * room.nq, placed);
            function(placed, found.data() + k * width);
        }
    }
    return array_of(found);
}

Output values(const Room& room, const Input& qs, double near, const Input& pairs) {
    std::vector<Pair> chosen;
    for (std::size_t k = 0; k < pairs.size(); ++k)
        chosen.push_back(room.pairs[static_cast<std::size_t>(index(pairs.data()[k], room.pairs.size()))]);
    return of_each(room, qs, chosen.size(), [&](const Placed& placed, double* found) {
        for (const Pair& pair : chosen) *found++ = room.distance(pair, placed, near);
    });
}

Output groups(const Room& room, const Input& qs, double near) {
    return of_each(room, qs, static_cast<std::size_t>(room.num_groups),
                   [&](const Placed& placed, double* found) { room.groups(placed, near, found); });
}

Output nearest(const Room& room, const Input& qs, double near) {
    std::vector<double> found(room.pairs.size(), near);
    of_each(room, qs, 0, [&](const Placed& placed, double*) { room.lower(placed, near, found.data()); });
    return array_of(found);
}

Output joints(const Room& room, const Input& qs) {
    const std::size_t count = count_of(room, qs);
    std::vector<double> found;
    found.reserve(count * (room.joints.size() + 1) * 12);
    Placed placed;
    for (std::size_t k = 0; k < count; ++k) {
        room.place_joints(qs.data() + k * room.nq, placed);
        for (const Pose& pose : placed.joints)
            for (std::size_t row = 0; row < 3; ++row) {
                found.insert(found.end(), pose.axes.begin() + 3 * row, pose.axes.begin() + 3 * row + 3);
                found.push_back(pose.origin[row]);
            }
    }
    return array_of(found);
}

Output least(const Room& room, const Input& qs, double most) {
    return of_each(room, qs, 1, [&](const Placed& placed, double* found) { *found = room.least(placed, most); });
}

Output way(const Room& room, const Input& ends, const Input& ranges, const Input& groups, double reserve, double step,
           double resolution, int most, int cuts, std::uint64_t seed) {
    const std::size_t nq = static_cast<std::size_t>(room.nq);
    check(ends.size() == 2 * nq && ranges.size() == 3 * nq, "ends, ranges: one number for each of a configuration");
    check(groups.size() % 2 == 0 && step > 0.0 && resolution > 0.0, "groups, step, resolution");
    const double *r = ranges.data(), *q0 = ends.data(), *q1 = q0 + nq;
    SearchOptions options{{r, r + nq}, {r + nq, r + 2 * nq}, {r + 2 * nq, r + 3 * nq}, {}, step, resolution, most,
                          seed};
    for (std::size_t k = 0; k < groups.size(); k += 2) {
        const int first = static_cast<int>(groups.data()[k]), size = static_cast<int>(groups.data()[k + 1]);
        check(first >= 0 && size > 0 && first + size <= room.nq, "groups: beyond the configuration");
        options.groups.push_back({first, size});
    }
    std::vector<double> found;
    {
        nb::gil_scoped_release released;
        Search search(room, std::move(options));
        found = search.is_free(q0, q1, reserve) ? std::vector<double>(q0, q0 + 2 * nq) : search.way(q0, q1, reserve);
        found = search.cut(std::move(found), reserve, cuts);
    }
    return array_of(found);
}

}  // namespace

}  // namespace mbocp

NB_MODULE(_room, module) {
    module.doc() = "Clearances at configurations, and ways that keep them.";
    nb::class_<mbocp::Room>(module, "Room")
        .def(
            "__init__",
            [](mbocp::Room* self, int nq, const mbocp::Input& joints, const mbocp::Input& places,
               const mbocp::Input& spheres, const mbocp::Input& shapes, const mbocp::Input& planes,
               const mbocp::Input& pairs) {
                new (self) mbocp::Room(mbocp::made(nq, joints, places, spheres, shapes, planes, pairs));
            },
            nb::kw_only(), "nq"_a, "joints"_a, "places"_a, "spheres"_a, "shapes"_a, "planes"_a, "pairs"_a)
        .def("values", &mbocp::values, "qs"_a, "near"_a, "pairs"_a,
             "Clearance of pairs at each configuration where it is below `near`, elsewhere a number between [m].")
        .def("groups", &mbocp::groups, "qs"_a, "near"_a,
             "The same of each group, its least clearance beyond margins, with sharp edges [m].")
        .def("nearest", &mbocp::nearest, "qs"_a, "near"_a,
             "Least clearance of each pair beyond its margin at all configurations, at most `near` [m].")
        .def("joints", &mbocp::joints, "qs"_a,
             "Rotation and origin of each joint, the world first, as 3 x 4 matrices by rows at each configuration.")
        .def("least", &mbocp::least, "qs"_a, "most"_a,
             "Least clearance beyond margins at each configuration, at most `most` [m].")
        .def("way", &mbocp::way, nb::kw_only(), "ends"_a, "ranges"_a, "groups"_a, "reserve"_a, "step"_a, "resolution"_a,
             "most"_a, "cuts"_a, "seed"_a,
             "Corners of a way between the ends that keeps a reserve; empty if none is found.");
}
