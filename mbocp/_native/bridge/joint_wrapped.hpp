// What an AnyJoint holds. Including this instantiates Pinocchio's 25 joint types: only where they are needed.
#pragma once

#include "joint.hpp"

namespace mbocp {
struct WrappedModel {
    pin::JointModelTpl<SX> joint;
};

struct WrappedData {
    pin::JointDataTpl<SX> joint;
};
}  // namespace mbocp
