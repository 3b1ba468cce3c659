// Placements, velocities and Jacobians of frames, and of the constraints between two of them.
#include "bridge.hpp"
#include "tree.hpp"

#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/algorithm/kinematics.hpp>

namespace mbocp {
namespace {
using Jacobian = Data::Matrix6x;
using SE3 = pin::SE3Tpl<SX>;

SE3 placement(const Attachment& attachment) {
    return pin::SE3(Eigen::Map<const Eigen::Matrix3d>(attachment.rotation.data()),
                    Eigen::Map<const Eigen::Vector3d>(attachment.translation.data()))
        .cast<SX>();
}

// In the attachment's own frame; a joint Jacobian of the universe is zero.
Jacobian attachment_jacobian(const Tree& tree, Data& data, const Attachment& attachment) {
    Jacobian J = Jacobian::Zero(6, tree.model.nv);
    if (attachment.joint > 0)
        pin::getFrameJacobian(tree.model, data, attachment.joint, placement(attachment), pin::LOCAL, J);
    return J;
}

// As pinocchio::getConstraintJacobian defines it: the motion of the first frame less that of the second.
SX constraint_rows(const Tree& tree, Data& data, const RigidConstraint& constraint) {
    const SE3 oM1 = data.oMi[constraint.first.joint] * placement(constraint.first);
    const SE3 oM2 = data.oMi[constraint.second.joint] * placement(constraint.second);
    const SE3 M12 = oM1.actInv(oM2);
    Jacobian J1 = attachment_jacobian(tree, data, constraint.first);
    const Jacobian J2 = attachment_jacobian(tree, data, constraint.second);
    if (constraint.rows == 6)
        J1 -= M12.toActionMatrix() * J2;
    else
        J1.topRows<3>() -= M12.rotation() * J2.topRows<3>();
    if (constraint.world_aligned) {
        J1.topRows<3>() = (oM1.rotation() * J1.topRows<3>()).eval();
        J1.bottomRows<3>() = (oM1.rotation() * J1.bottomRows<3>()).eval();
    }
    return to_casadi(J1.topRows(constraint.rows));
}
}  // namespace

casadi::Function frame_placement(const Tree& tree, int frame) {
    const SX q = SX::sym("q", tree.nq);
    Data& data = tree.scratch();
    pin::forwardKinematics(tree.model, data, tree.configuration(q));
    const auto& oMf = pin::updateFramePlacement(tree.model, data, frame);
    return tree.function("frame_placement", {q}, {to_casadi(oMf.rotation()), to_casadi(oMf.translation())}, {"q"},
                         {"R", "p"});
}

casadi::Function frame_jacobian(const Tree& tree, int frame, int reference) {
    const SX q = SX::sym("q", tree.nq);
    Data& data = tree.scratch();
    Jacobian J = Jacobian::Zero(6, tree.model.nv);
    pin::computeFrameJacobian(tree.model, data, tree.configuration(q), frame, pin::ReferenceFrame(reference), J);
    return tree.function("frame_jacobian", {q}, {tree.jacobian(to_casadi(J))}, {"q"}, {"J"});
}

casadi::Function frame_velocity(const Tree& tree, int frame, int reference) {
    const SX q = SX::sym("q", tree.nq), v = SX::sym("v", tree.nv);
    Data& data = tree.scratch();
    pin::forwardKinematics(tree.model, data, tree.configuration(q), tree.velocity(v));
    const auto twist = pin::getFrameVelocity(tree.model, data, frame, pin::ReferenceFrame(reference));
    return tree.function("frame_velocity", {q, v}, {to_casadi(twist.toVector())}, {"q", "v"}, {"twist"});
}

casadi::Function constraint_jacobian(const Tree& tree, const std::vector<RigidConstraint>& constraints) {
    const SX q = SX::sym("q", tree.nq);
    Data& data = tree.scratch();
    pin::computeJointJacobians(tree.model, data, tree.configuration(q));
    std::vector<SX> rows;
    for (const RigidConstraint& constraint : constraints) rows.push_back(constraint_rows(tree, data, constraint));
    const SX J = rows.empty() ? SX::zeros(0, tree.model.nv) : vertcat(rows);
    return tree.function("constraint_jacobian", {q}, {tree.jacobian(J)}, {"q"}, {"J"});
}
}  // namespace mbocp
