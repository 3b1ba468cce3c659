// The Python module: a robot's functions, each as the text of casadi::Function::serialize().
//
// Text crosses, objects do not: this module and Python's casadi need not agree on more than the format.
#include "bridge.hpp"

#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <map>
#include <stdexcept>

namespace nb = nanobind;

namespace {
using Builder = casadi::Function (*)(const mbocp::Tree&);

const std::map<std::string, Builder> builders = {
    {"rnea", &mbocp::rnea},
    {"nonlinear_effects", &mbocp::nonlinear_effects},
    {"gravity", &mbocp::gravity},
    {"aba", &mbocp::aba},
    {"minverse", &mbocp::minverse},
    {"crba", &mbocp::crba},
    {"kinetic_energy", &mbocp::kinetic_energy},
    {"potential_energy", &mbocp::potential_energy},
    {"center_of_mass", &mbocp::center_of_mass},
    {"centroidal_momentum", &mbocp::centroidal_momentum},
    {"integrate", &mbocp::integrate},
    {"difference", &mbocp::difference},
    {"dintegrate", &mbocp::dintegrate},
};

const std::map<std::string, mbocp::ModelNumber::Of> numbers_of = {
    {"inertia", mbocp::ModelNumber::Of::inertia},
    {"joint_placement", mbocp::ModelNumber::Of::joint_placement},
    {"frame_placement", mbocp::ModelNumber::Of::frame_placement},
};

class Robot {
public:
    Robot(const std::string& serialized_model, const std::vector<mbocp::ModelNumber>& given)
        : tree(mbocp::load_tree(serialized_model, given)) {}

    std::string function(const std::string& name) const {
        const auto found = builders.find(name);
        if (found == builders.end()) throw std::invalid_argument("no function named '" + name + "'");
        return found->second(*tree).serialize();
    }

    std::string frame_placement(int frame) const { return mbocp::frame_placement(*tree, checked(frame)).serialize(); }

    std::string frame_jacobian(int frame, int reference) const {
        return mbocp::frame_jacobian(*tree, checked(frame), reference).serialize();
    }

    std::string frame_velocity(int frame, int reference) const {
        return mbocp::frame_velocity(*tree, checked(frame), reference).serialize();
    }

    std::string constraint_jacobian(const std::vector<mbocp::RigidConstraint>& constraints) const {
        for (const mbocp::RigidConstraint& constraint : constraints)
            for (const int joint : {constraint.first.joint, constraint.second.joint})
                if (joint < 0 || joint >= mbocp::joint_count(*tree))
                    throw std::out_of_range("no joint of index " + std::to_string(joint));
        return mbocp::constraint_jacobian(*tree, constraints).serialize();
    }

    int nq() const { return mbocp::configuration_size(*tree); }
    int nv() const { return mbocp::velocity_size(*tree); }

private:
    int checked(int frame) const {
        if (frame < 0 || frame >= mbocp::frame_count(*tree))
            throw std::out_of_range("no frame of index " + std::to_string(frame));
        return frame;
    }

    std::shared_ptr<const mbocp::Tree> tree;
};
}  // namespace

NB_MODULE(_bridge, m) {
    using namespace nb::literals;
    m.doc() = "Pinocchio's algorithms with CasADi's scalar, as serialized CasADi functions.";
    nb::class_<mbocp::Attachment>(m, "Attachment", "A frame fixed to a joint.")
        .def(nb::init<int, std::array<double, 9>, std::array<double, 3>>(), "joint"_a, "rotation"_a, "translation"_a);
    nb::class_<mbocp::RigidConstraint>(m, "RigidConstraint", "Two frames that coincide, or their origins.")
        .def(nb::init<int, mbocp::Attachment, mbocp::Attachment, bool>(), "rows"_a, "first"_a, "second"_a,
             "world_aligned"_a);
    using mbocp::ModelNumber;
    nb::class_<ModelNumber>(m, "ModelNumber", "A number of a model that functions take as an argument.")
        .def(
            "__init__",
            [](ModelNumber* self, const std::string& of, int index, int entry) {
                const auto found = numbers_of.find(of);
                if (found == numbers_of.end()) throw std::invalid_argument("a model has no '" + of + "'");
                new (self) ModelNumber{found->second, index, entry};
            },
            "of"_a, "index"_a, "entry"_a);
    nb::class_<Robot>(m, "Robot", "A model with CasADi's scalar.")
        .def(nb::init<const std::string&, const std::vector<ModelNumber>&>(), "serialized_model"_a,
             "given"_a = std::vector<ModelNumber>())
        .def_prop_ro("nq", &Robot::nq)
        .def_prop_ro("nv", &Robot::nv)
        .def("function", &Robot::function, "name"_a)
        .def("frame_placement", &Robot::frame_placement, "frame"_a)
        .def("frame_jacobian", &Robot::frame_jacobian, "frame"_a, "reference"_a)
        .def("frame_velocity", &Robot::frame_velocity, "frame"_a, "reference"_a)
        .def("constraint_jacobian", &Robot::constraint_jacobian, "constraints"_a);
}
