// The configuration manifold: the product of the joints' Lie groups. A mimic joint has no coordinates of its own.
#include "bridge.hpp"
#include "joint_wrapped.hpp"
#include "tree.hpp"

#include <pinocchio/multibody/liegroup.hpp>

namespace mbocp {
namespace {
using Manifold = pin::LieGroupMap::operationProduct<SX, 0>::type;
using MatrixX = Eigen::Matrix<SX, Eigen::Dynamic, Eigen::Dynamic>;

Manifold manifold(const Tree& tree) {
    Manifold product;
    for (pin::JointIndex id = 1; id < (pin::JointIndex)tree.model.njoints; ++id) {
        const auto& joint = boost::get<AnyJoint>(tree.model.joints[id].toVariant());
        if (joint.size_q > 0 && tree.source_q[joint.idx_q()] >= 0)
            product *= joint.wrapped->joint.lieGroup<pin::LieGroupMap>();
    }
    return product;
}
}  // namespace

casadi::Function integrate(const Tree& tree) {
    const SX q = SX::sym("q", tree.nq), v = SX::sym("v", tree.nv);
    VectorX q1(tree.nq);
    manifold(tree).integrate(to_eigen(q), to_eigen(v), q1);
    return tree.function("integrate", {q, v}, {to_casadi(q1)}, {"q", "v"}, {"q1"});
}

casadi::Function difference(const Tree& tree) {
    const SX q0 = SX::sym("q0", tree.nq), q1 = SX::sym("q1", tree.nq);
    VectorX v(tree.nv);
    manifold(tree).difference(to_eigen(q0), to_eigen(q1), v);
    return tree.function("difference", {q0, q1}, {to_casadi(v)}, {"q0", "q1"}, {"v"});
}

casadi::Function dintegrate(const Tree& tree) {
    const SX q = SX::sym("q", tree.nq), v = SX::sym("v", tree.nv);
    const VectorX qe = to_eigen(q), ve = to_eigen(v);
    const Manifold group = manifold(tree);
    MatrixX J_q = MatrixX::Zero(tree.nv, tree.nv), J_v = MatrixX::Zero(tree.nv, tree.nv);
    group.dIntegrate_dq(qe, ve, J_q);
    group.dIntegrate_dv(qe, ve, J_v);
    return tree.function("dintegrate", {q, v}, {to_casadi(J_q), to_casadi(J_v)}, {"q", "v"}, {"J_q", "J_v"});
}
}  // namespace mbocp
