// A Pinocchio joint collection with one member: a joint whose type is known at run time only.
//
// Pinocchio instantiates every pass of every algorithm for each of its 25 joint types; with CasADi's scalar that is
// minutes and gigabytes of compilation. The collection of joints is a template parameter of its models, and here it
// holds a single joint that forwards `calc` and `calc_aba` to a joint of the default collection, in joint*.cpp.
// The algorithms remain Pinocchio's own, instantiated once. The graphs are the same: the wrapped joint's zeros and
// ones are constants, which CasADi folds.
#pragma once

#include "pinocchio.hpp"

namespace mbocp {
template <typename Scalar, int Options>
struct AnyJointCollectionTpl;
template <typename Scalar, int Options>
struct AnyJointTpl;
template <typename Scalar, int Options>
struct AnyJointModelTpl;
template <typename Scalar, int Options>
struct AnyJointDataTpl;

// What is behind an AnyJoint; complete in joint_wrapped.hpp only.
struct WrappedModel;
struct WrappedData;
}  // namespace mbocp

namespace pinocchio {
template <typename Sc, int Op>
struct traits<mbocp::AnyJointTpl<Sc, Op>> {
    static constexpr int Options = Op;
    static constexpr int NQ = Eigen::Dynamic;
    static constexpr int NV = Eigen::Dynamic;
    static constexpr int NVExtended = Eigen::Dynamic;

    typedef Sc Scalar;
    typedef mbocp::AnyJointDataTpl<Sc, Op> JointDataDerived;
    typedef mbocp::AnyJointModelTpl<Sc, Op> JointModelDerived;
    typedef JointMotionSubspaceTpl<Eigen::Dynamic, Sc, Op> Constraint_t;
    typedef SE3Tpl<Sc, Op> Transformation_t;
    typedef MotionTpl<Sc, Op> Motion_t;
    typedef MotionTpl<Sc, Op> Bias_t;
    typedef Eigen::Matrix<Sc, 6, Eigen::Dynamic, Op> U_t;
    typedef Eigen::Matrix<Sc, Eigen::Dynamic, Eigen::Dynamic, Op> D_t;
    typedef Eigen::Matrix<Sc, 6, Eigen::Dynamic, Op> UD_t;
    typedef Eigen::Matrix<Sc, Eigen::Dynamic, 1, Op> ConfigVector_t;
    typedef Eigen::Matrix<Sc, Eigen::Dynamic, 1, Op> TangentVector_t;
    typedef std::false_type is_mimicable_t;

    PINOCCHIO_JOINT_DATA_BASE_ACCESSOR_DEFAULT_RETURN_TYPE
};

template <typename Sc, int Op>
struct traits<mbocp::AnyJointModelTpl<Sc, Op>> {
    typedef mbocp::AnyJointTpl<Sc, Op> JointDerived;
    typedef Sc Scalar;
};

template <typename Sc, int Op>
struct traits<mbocp::AnyJointDataTpl<Sc, Op>> {
    typedef mbocp::AnyJointTpl<Sc, Op> JointDerived;
    typedef Sc Scalar;
};

// Data's scratch copy of q starts at the neutral configuration: nothing reads it, and the manifold of an AnyJoint is
// that of the joint behind it (configuration.cpp).
template <typename Visitor, typename Sc, int Op>
struct NeutralStepAlgo<Visitor, mbocp::AnyJointModelTpl<Sc, Op>> {
    template <typename Q>
    static void run(const JointModelBase<mbocp::AnyJointModelTpl<Sc, Op>>& joint, const Eigen::MatrixBase<Q>& q) {
        joint.jointConfigSelector(q.const_cast_derived()).setZero();
    }
};
}  // namespace pinocchio

namespace mbocp {
using pinocchio::traits;  // what Pinocchio's macros look up

template <typename Sc, int Op>
struct AnyJointDataTpl : pinocchio::JointDataBase<AnyJointDataTpl<Sc, Op>> {
    typedef AnyJointTpl<Sc, Op> JointDerived;
    PINOCCHIO_JOINT_DATA_TYPEDEF_TEMPLATE(JointDerived);
    PINOCCHIO_JOINT_DATA_BASE_DEFAULT_ACCESSOR

    AnyJointDataTpl() : S(0) {}

    static std::string classname() { return "AnyJointData"; }
    std::string shortname() const { return classname(); }

    std::shared_ptr<WrappedData> wrapped;
    ConfigVector_t joint_q;
    TangentVector_t joint_v;
    Constraint_t S;
    Transformation_t M;
    Motion_t v;
    Bias_t c;
    U_t U;
    D_t Dinv;
    UD_t UDinv;
    D_t StU;
};

template <typename Sc, int Op>
struct AnyJointModelTpl : pinocchio::JointModelBase<AnyJointModelTpl<Sc, Op>> {
    typedef AnyJointTpl<Sc, Op> JointDerived;
    typedef pinocchio::JointModelBase<AnyJointModelTpl> Base;
    typedef Eigen::Matrix<Sc, Eigen::Dynamic, 1, Op> VectorX;
    typedef Eigen::Matrix<Sc, 6, 6, Op> Matrix6;
    PINOCCHIO_JOINT_TYPEDEF_TEMPLATE(JointDerived);
    using Base::idx_q;
    using Base::idx_v;
    using Base::idx_vExtended;
    using Base::nq;
    using Base::nv;
    using Base::nvExtended;
    using Base::setIndexes;

    int nq_impl() const { return size_q; }
    int nv_impl() const { return size_v; }
    int nvExtended_impl() const { return size_v; }
    const std::vector<bool> hasConfigurationLimit() const { return {}; }
    const std::vector<bool> hasConfigurationLimitInTangent() const { return {}; }
    static std::string classname() { return "AnyJointModel"; }
    std::string shortname() const { return classname(); }

    template <typename Q, typename V>
    void calc(JointDataDerived& data, const Eigen::MatrixBase<Q>& q, const Eigen::MatrixBase<V>& v) const {
        data.joint_q = q.segment(idx_q(), size_q);
        data.joint_v = v.segment(idx_v(), size_v);
        calc_kinematics(data, q.derived(), v.derived());
    }

    // Without a velocity: M and S do not depend on it, and algorithms that ask for no more read no more.
    template <typename Q>
    void calc(JointDataDerived& data, const Eigen::MatrixBase<Q>& q) const {
        calc(data, q, VectorX::Zero(idx_v() + size_v).eval());
    }

    template <typename A, typename I>
    void calc_aba(JointDataDerived& data, const Eigen::MatrixBase<A>& armature, const Eigen::MatrixBase<I>& inertia,
                  bool update) const {
        Matrix6 Y = inertia;
        calc_articulated(data, armature.derived(), Y, update);
        if (update) inertia.const_cast_derived() = Y;
    }

    // Defined in joint_wrap.cpp, joint.cpp and joint_articulated.cpp, for the one scalar.
    JointDataDerived createData() const;
    void calc_kinematics(JointDataDerived& data, const VectorX& q, const VectorX& v) const;
    void calc_articulated(JointDataDerived& data, const VectorX& armature, Matrix6& Y, bool update) const;

    std::shared_ptr<const WrappedModel> wrapped;
    int size_q = 0, size_v = 0;
};

template <typename Sc, int Op>
struct AnyJointCollectionTpl {
    typedef Sc Scalar;
    static constexpr int Options = Op;
    typedef boost::variant<AnyJointModelTpl<Sc, Op>> JointModelVariant;
    typedef boost::variant<AnyJointDataTpl<Sc, Op>> JointDataVariant;
};

using AnyJoint = AnyJointModelTpl<SX, 0>;
using AnyJointData = AnyJointDataTpl<SX, 0>;
using Model = pin::ModelTpl<SX, 0, AnyJointCollectionTpl>;
using Data = pin::DataTpl<SX, 0, AnyJointCollectionTpl>;
}  // namespace mbocp
