// The articulated-body step of one joint.
#include "joint_wrapped.hpp"

namespace mbocp {
template <>
void AnyJoint::calc_articulated(AnyJointData& data, const VectorX& armature, Matrix6& Y, bool update) const {
    pin::JointDataTpl<SX>& joint = data.wrapped->joint;
    pin::calc_aba(wrapped->joint, joint, armature, Y, update);
    data.U = joint.U();
    data.Dinv = joint.Dinv();
    data.UDinv = joint.UDinv();
    data.StU = joint.StU();
}
}  // namespace mbocp
