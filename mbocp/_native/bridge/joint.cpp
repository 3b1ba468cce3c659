// Kinematics of one joint: Pinocchio's `calc` for each joint type of the default collection.
#include "joint_wrapped.hpp"

namespace mbocp
{
  template<>
  AnyJointData AnyJoint::createData() const
  {
    AnyJointData data;
    data.wrapped = std::make_shared<WrappedData>();
    data.S = AnyJointData::Constraint_t::Zero(size_v);
    data.U = data.UDinv = AnyJointData::U_t::Zero(6, size_v);
    data.Dinv = data.StU = AnyJointData::D_t::Zero(size_v, size_v);
    if (wrapped) // the universe has none
      data.wrapped->joint = wrapped->joint.createData();
    return data;
  }

  template<>
  void AnyJoint::calc_position(AnyJointData & data, const VectorX & q) const
  {
    pin::calc_zero_order(wrapped->joint, data.wrapped->joint, q);
    publish_kinematics(data);
  }
} // namespace mbocp
