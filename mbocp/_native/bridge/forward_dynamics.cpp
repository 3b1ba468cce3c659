// Forward dynamics: the articulated-body algorithm and the inverse of the inertia matrix.
#include "bridge.hpp"
#include "tree.hpp"

#include <pinocchio/algorithm/aba.hpp>

namespace mbocp {
namespace {
// With mimic joints the articulated bodies are coupled: solve with the inertia matrix instead.
SX divide(const SX& M, const SX& b) {
    SX D, LT;
    std::vector<casadi_int> p;
    SX::ldl(M, D, LT, p, false);
    return densify(SX::ldl_solve(b, D, LT, p));
}
}  // namespace

casadi::Function aba(const Tree& tree) {
    const SX q = SX::sym("q", tree.nq), v = SX::sym("v", tree.nv), tau = SX::sym("tau", tree.nv);
    SX a;
    if (tree.mimics.empty()) {
        Data& data = tree.scratch();
        pin::aba(tree.model, data, to_eigen(q), to_eigen(v), to_eigen(tau), pin::Convention::LOCAL);
        a = to_casadi(data.ddq);
    } else {
        a = divide(crba(tree)(tree.inputs({q})).at(0), tau - nonlinear_effects(tree)(tree.inputs({q, v})).at(0));
    }
    return tree.function("aba", {q, v, tau}, {a}, {"q", "v", "tau"}, {"a"});
}

casadi::Function minverse(const Tree& tree) {
    const SX q = SX::sym("q", tree.nq);
    SX Minv;
    if (tree.mimics.empty()) {
        Data& data = tree.scratch();
        pin::computeMinverse(tree.model, data, to_eigen(q));
        data.Minv.triangularView<Eigen::StrictlyLower>() = data.Minv.transpose().triangularView<Eigen::StrictlyLower>();
        Minv = to_casadi(data.Minv);
    } else {
        Minv = divide(crba(tree)(tree.inputs({q})).at(0), SX::eye(tree.nv));
    }
    return tree.function("minverse", {q}, {Minv}, {"q"}, {"Minv"});
}
}  // namespace mbocp
