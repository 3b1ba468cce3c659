// A robot's model with CasADi's scalar.
#pragma once

#include "bridge.hpp"
#include "joint.hpp"

namespace mbocp {
// Mimic joints become joints in their own right, whose coordinates are an affine function of the mimicked ones:
// then each of Pinocchio's algorithms serves, also those that do not know mimic joints. Lower case: what the user
// sees, (nq,) and (nv,). Upper case: the whole tree, (model.nq,) and (model.nv,).
struct Tree {
    explicit Tree(const std::string& serialized_model, const std::vector<ModelNumber>& given = {});

    VectorX configuration(const SX& q) const;  // Q(q)
    VectorX velocity(const SX& v) const;       // V = A v
    SX force(const VectorX& T) const;          // A^T T
    SX jacobian(const SX& J) const;            // J A
    SX inertia(const SX& M) const;             // A^T M A

    // Inputs of a function with the given numbers of the model behind them, if there are any.
    std::vector<SX> inputs(std::vector<SX> own) const;
    casadi::Function function(const std::string& name, const std::vector<SX>& own, const std::vector<SX>& outputs,
                              std::vector<std::string> names_in, const std::vector<std::string>& names_out) const;

    // One Data serves all functions, as in numeric use; a new one takes seconds for a hundred joints.
    Data& scratch() const;

    struct Mimic {
        pin::JointIndex joint;
        int idx_q;  // of the mimicked joint, in q
        double scaling, offset;
    };

    Model model;
    int nq = 0, nv = 0;
    std::vector<Mimic> mimics;
    std::vector<int> source_q;  // for each entry of Q the one of q, -1 below a mimic joint
    SX A;                       // (model.nv, nv)
    SX numbers;                 // the given ones

private:
    mutable std::unique_ptr<Data> data;
};

AnyJoint wrap_joint(const pin::JointModel& joint, pin::JointIndex id, int idx_q, int idx_v);
VectorX scaled_configuration(const AnyJoint& joint, const VectorX& q, double scaling, double offset);

inline VectorX to_eigen(const SX& s) {
    VectorX v(s.size1());
    for (casadi_int i = 0; i < s.size1(); ++i) v[i] = s(i);
    return v;
}

template <typename D>
SX to_casadi(const Eigen::MatrixBase<D>& m) {
    SX s = SX::zeros(m.rows(), m.cols());
    for (Eigen::Index j = 0; j < m.cols(); ++j)
        for (Eigen::Index i = 0; i < m.rows(); ++i) s(i, j) = m(i, j);
    return s;
}
}  // namespace mbocp
