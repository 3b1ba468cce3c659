// What an AnyJoint holds. Including this instantiates Pinocchio's 25 joint types: only where they are needed.
#pragma once

#include "joint.hpp"

namespace mbocp
{
  struct WrappedModel
  {
    pin::JointModelTpl<SX> joint;
  };

  struct WrappedData
  {
    pin::JointDataTpl<SX> joint;
  };

  // Pass on what `calc` has found.
  inline void publish_kinematics(AnyJointData & data)
  {
    const pin::JointDataTpl<SX> & joint = data.wrapped->joint;
    data.S = joint.S();
    data.M = joint.M();
    data.v = joint.v();
    data.c = joint.c();
  }
} // namespace mbocp
