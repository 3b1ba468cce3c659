// Kinematics of one joint: Pinocchio's `calc` for each joint type of the default collection.
#include "joint_wrapped.hpp"

namespace mbocp {
template <>
void AnyJoint::calc_kinematics(AnyJointData& data, const VectorX& q, const VectorX& v) const {
    pin::JointDataTpl<SX>& joint = data.wrapped->joint;
    pin::calc_first_order(wrapped->joint, joint, q, v);
    data.S = joint.S();
    data.M = joint.M();
    data.v = joint.v();
    data.c = joint.c();
}
}  // namespace mbocp
