// The inertia matrix, energies, centre of mass and centroidal momentum.
#include "bridge.hpp"
#include "tree.hpp"

#include <pinocchio/algorithm/center-of-mass.hpp>
#include <pinocchio/algorithm/centroidal.hpp>
#include <pinocchio/algorithm/crba.hpp>
#include <pinocchio/algorithm/energy.hpp>

namespace mbocp {
casadi::Function crba(const Tree& tree) {
    const SX q = SX::sym("q", tree.nq);
    Data& data = tree.scratch();
    pin::crba(tree.model, data, tree.configuration(q), pin::Convention::WORLD);
    data.M.triangularView<Eigen::StrictlyLower>() = data.M.transpose().triangularView<Eigen::StrictlyLower>();
    return tree.function("crba", {q}, {tree.inertia(to_casadi(data.M))}, {"q"}, {"M"});
}

casadi::Function kinetic_energy(const Tree& tree) {
    const SX q = SX::sym("q", tree.nq), v = SX::sym("v", tree.nv);
    Data& data = tree.scratch();
    const SX T = pin::computeKineticEnergy(tree.model, data, tree.configuration(q), tree.velocity(v));
    return tree.function("kinetic_energy", {q, v}, {T}, {"q", "v"}, {"T"});
}

casadi::Function potential_energy(const Tree& tree) {
    const SX q = SX::sym("q", tree.nq);
    Data& data = tree.scratch();
    const SX V = pin::computePotentialEnergy(tree.model, data, tree.configuration(q));
    return tree.function("potential_energy", {q}, {V}, {"q"}, {"V"});
}

casadi::Function center_of_mass(const Tree& tree) {
    const SX q = SX::sym("q", tree.nq);
    Data& data = tree.scratch();
    pin::centerOfMass(tree.model, data, tree.configuration(q), false);
    return tree.function("center_of_mass", {q}, {to_casadi(data.com[0])}, {"q"}, {"c"});
}

casadi::Function centroidal_momentum(const Tree& tree) {
    const SX q = SX::sym("q", tree.nq), v = SX::sym("v", tree.nv);
    Data& data = tree.scratch();
    pin::computeCentroidalMomentum(tree.model, data, tree.configuration(q), tree.velocity(v));
    return tree.function("centroidal_momentum", {q, v}, {to_casadi(data.hg.toVector())}, {"q", "v"}, {"h"});
}
}  // namespace mbocp
