// Placements, velocities and Jacobians of frames.
#include "bridge.hpp"
#include "tree.hpp"

#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/algorithm/kinematics.hpp>

namespace mbocp
{
  casadi::Function frame_placement(const Tree & tree, int frame)
  {
    const SX q = SX::sym("q", tree.nq);
    Data data(tree.model);
    pin::forwardKinematics(tree.model, data, tree.configuration(q));
    const auto & oMf = pin::updateFramePlacement(tree.model, data, frame);
    return {"frame_placement", {q}, {to_casadi(oMf.rotation()), to_casadi(oMf.translation())}, {"q"}, {"R", "p"}};
  }

  casadi::Function frame_jacobian(const Tree & tree, int frame, int reference)
  {
    const SX q = SX::sym("q", tree.nq);
    Data data(tree.model);
    Data::Matrix6x J = Data::Matrix6x::Zero(6, tree.model.nv);
    pin::computeFrameJacobian(tree.model, data, tree.configuration(q), frame, pin::ReferenceFrame(reference), J);
    return {"frame_jacobian", {q}, {tree.jacobian(to_casadi(J))}, {"q"}, {"J"}};
  }

  casadi::Function frame_velocity(const Tree & tree, int frame, int reference)
  {
    const SX q = SX::sym("q", tree.nq), v = SX::sym("v", tree.nv);
    Data data(tree.model);
    pin::forwardKinematics(tree.model, data, tree.configuration(q), tree.velocity(v));
    const auto twist = pin::getFrameVelocity(tree.model, data, frame, pin::ReferenceFrame(reference));
    return {"frame_velocity", {q, v}, {to_casadi(twist.toVector())}, {"q", "v"}, {"twist"}};
  }
} // namespace mbocp
