// The interface between the Python module and the algorithms: no Pinocchio in it, so that module.cpp compiles fast.
#pragma once

#include <casadi/casadi.hpp>

#include <array>
#include <memory>
#include <string>
#include <vector>

namespace mbocp {
struct Tree;

// A frame fixed to a joint: rotation by columns, translation [m].
struct Attachment {
    int joint;
    std::array<double, 9> rotation;
    std::array<double, 3> translation;
};

// Pinocchio's RigidConstraintModel: 3 rows (points coincide) or 6 (frames coincide), in the axes of the first frame
// or of the world.
struct RigidConstraint {
    int rows;
    Attachment first, second;
    bool world_aligned;
};

// A number of the model that functions take as an argument. Entries of inertias: mass, centre of mass (3), moments
// about it xx, xy, yy, xz, yz, zz. Entries of placements: rotation by columns (9), translation (3).
struct ModelNumber {
    enum class Of { inertia, joint_placement, frame_placement };
    Of of;
    int index;  // of the joint or frame
    int entry;
};

std::shared_ptr<const Tree> load_tree(const std::string& serialized_model, const std::vector<ModelNumber>& given);
int configuration_size(const Tree& tree);
int velocity_size(const Tree& tree);
int joint_count(const Tree& tree);
int frame_count(const Tree& tree);

// Inverse dynamics.
casadi::Function rnea(const Tree& tree);
casadi::Function nonlinear_effects(const Tree& tree);
casadi::Function gravity(const Tree& tree);
// Forward dynamics.
casadi::Function aba(const Tree& tree);
casadi::Function minverse(const Tree& tree);
// Inertia.
casadi::Function crba(const Tree& tree);
casadi::Function kinetic_energy(const Tree& tree);
casadi::Function potential_energy(const Tree& tree);
casadi::Function center_of_mass(const Tree& tree);
casadi::Function centroidal_momentum(const Tree& tree);
// The configuration manifold.
casadi::Function integrate(const Tree& tree);
casadi::Function difference(const Tree& tree);
casadi::Function dintegrate(const Tree& tree);
// Frames; `reference` is Pinocchio's ReferenceFrame.
casadi::Function frame_placement(const Tree& tree, int frame);
casadi::Function frame_jacobian(const Tree& tree, int frame, int reference);
casadi::Function frame_velocity(const Tree& tree, int frame, int reference);
casadi::Function constraint_jacobian(const Tree& tree, const std::vector<RigidConstraint>& constraints);
}  // namespace mbocp
