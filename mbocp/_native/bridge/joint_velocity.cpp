// Kinematics of one joint with its velocity.
#include "joint_wrapped.hpp"

namespace mbocp
{
  template<>
  void AnyJoint::calc_velocity(AnyJointData & data, const VectorX & q, const VectorX & v) const
  {
    pin::calc_first_order(wrapped->joint, data.wrapped->joint, q, v);
    publish_kinematics(data);
  }
} // namespace mbocp
