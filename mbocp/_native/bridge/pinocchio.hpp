// Pinocchio and CasADi, in the one order in which they compile together, and the names used everywhere.
#pragma once

#include <pinocchio/autodiff/casadi.hpp>

#include <unsupported/Eigen/CXX11/Tensor>

// Pinocchio's Data has arrays of nv^3 entries for second derivatives, which nothing here asks for: for a hundred
// joints they take seconds to fill, for five hundred gigabytes. With CasADi's scalar they have no entries.
template <>
class Eigen::Tensor<casadi::SX, 3, 0, Eigen::Index> {
public:
    Tensor() = default;
    Tensor(Eigen::Index, Eigen::Index, Eigen::Index) {}
    void setZero() {}
};

#include <pinocchio/multibody.hpp>
#include <pinocchio/multibody/joint.hpp>
#include <pinocchio/multibody/liegroup.hpp>

#include <memory>
#include <string>
#include <vector>

namespace mbocp {
namespace pin = pinocchio;
using SX = casadi::SX;
using VectorX = Eigen::Matrix<SX, Eigen::Dynamic, 1>;
}  // namespace mbocp
