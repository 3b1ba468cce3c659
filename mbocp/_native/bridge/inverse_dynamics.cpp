// Inverse dynamics: RNEA and its parts.
#include "bridge.hpp"
#include "tree.hpp"

#include <pinocchio/algorithm/rnea.hpp>

namespace mbocp {
casadi::Function rnea(const Tree& tree) {
    const SX q = SX::sym("q", tree.nq), v = SX::sym("v", tree.nv), a = SX::sym("a", tree.nv);
    Data& data = tree.scratch();
    pin::rnea(tree.model, data, tree.configuration(q), tree.velocity(v), tree.velocity(a));
    return tree.function("rnea", {q, v, a}, {tree.force(data.tau)}, {"q", "v", "a"}, {"tau"});
}

casadi::Function nonlinear_effects(const Tree& tree) {
    const SX q = SX::sym("q", tree.nq), v = SX::sym("v", tree.nv);
    Data& data = tree.scratch();
    pin::nonLinearEffects(tree.model, data, tree.configuration(q), tree.velocity(v));
    return tree.function("nonlinear_effects", {q, v}, {tree.force(data.nle)}, {"q", "v"}, {"nle"});
}

casadi::Function gravity(const Tree& tree) {
    const SX q = SX::sym("q", tree.nq);
    Data& data = tree.scratch();
    pin::computeGeneralizedGravity(tree.model, data, tree.configuration(q));
    return tree.function("gravity", {q}, {tree.force(data.g)}, {"q"}, {"g"});
}
}  // namespace mbocp
