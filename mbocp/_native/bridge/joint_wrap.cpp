// From a joint of the numeric model to an AnyJoint, its data, and the affine map of mimic joints.
#include "joint_wrapped.hpp"
#include "tree.hpp"

namespace mbocp {
AnyJoint wrap_joint(const pin::JointModel& joint, pin::JointIndex id, int idx_q, int idx_v) {
    auto wrapped = std::make_shared<WrappedModel>();
    wrapped->joint = joint.cast<SX>();
    wrapped->joint.setIndexes(id, idx_q, idx_v, idx_v);
    AnyJoint any;
    any.setIndexes(id, idx_q, idx_v, idx_v);
    any.size_q = joint.nq();
    any.size_v = joint.nv();
    any.wrapped = wrapped;
    return any;
}

template <>
AnyJointData AnyJoint::createData() const {
    AnyJointData data;
    data.wrapped = std::make_shared<WrappedData>();
    data.S = AnyJointData::Constraint_t::Zero(size_v);
    data.U = data.UDinv = AnyJointData::U_t::Zero(6, size_v);
    data.Dinv = data.StU = AnyJointData::D_t::Zero(size_v, size_v);
    if (wrapped)  // the universe has none
        data.wrapped->joint = wrapped->joint.createData();
    return data;
}

VectorX scaled_configuration(const AnyJoint& any, const VectorX& q, double scaling, double offset) {
    VectorX result(q.size());
    pin::configVectorAffineTransform(any.wrapped->joint, q, SX(scaling), SX(offset), result);
    return result;
}
}  // namespace mbocp
