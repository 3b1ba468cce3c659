// Pinocchio and CasADi, in the one order in which they compile together, and the names used everywhere.
#pragma once

#include <pinocchio/autodiff/casadi.hpp>

#include <pinocchio/multibody.hpp>
#include <pinocchio/multibody/joint.hpp>
#include <pinocchio/multibody/liegroup.hpp>

#include <memory>
#include <string>
#include <vector>

namespace mbocp
{
  namespace pin = pinocchio;
  using SX = casadi::SX;
  using VectorX = Eigen::Matrix<SX, Eigen::Dynamic, 1>;
} // namespace mbocp
