// From Pinocchio's serialized model to a tree with CasADi's scalar.
#include "tree.hpp"

#include "bridge.hpp"

#include <pinocchio/serialization.hpp>

#include <sstream>
#include <stdexcept>

namespace mbocp {
namespace {
// The joint that moves: for a mimic joint the one inside it.
const pin::JointModel& moving(const pin::JointModel& joint) {
    const auto* mimic = boost::get<pin::JointModelMimic>(&joint.toVariant());
    return mimic ? mimic->jmodel() : joint;
}

void copy_topology(const pin::Model& source, Model& model) {
    model.name = source.name;
    model.names = source.names;
    model.njoints = source.njoints;
    model.nbodies = source.nbodies;
    model.parents = source.parents;
    model.children = source.children;
    model.subtrees = source.subtrees;
    model.supports = source.supports;
    model.mimic_joint_supports.assign(source.supports.size(), {0});
    model.gravity = source.gravity.cast<SX>();
    for (const auto& inertia : source.inertias) model.inertias.push_back(inertia.cast<SX>());
    for (const auto& placement : source.jointPlacements) model.jointPlacements.push_back(placement.cast<SX>());
    model.nframes = source.nframes;
    for (const auto& frame : source.frames) model.frames.push_back(frame.cast<SX>());
}

void append_joint(Model& model, const pin::JointModel& joint, pin::JointIndex id) {
    const int nq = joint.nq(), nv = joint.nv();
    model.joints.push_back(wrap_joint(joint, id, model.nq, model.nv));
    model.idx_qs.push_back(model.nq);
    model.nqs.push_back(nq);
    model.idx_vs.push_back(model.nv);
    model.nvs.push_back(nv);
    model.idx_vExtendeds.push_back(model.nv);
    model.nvExtendeds.push_back(nv);
    model.nq += nq;
    model.nv += nv;
    model.nvExtended += nv;
}
SX& entry_of(pin::SE3Tpl<SX>& placement, int entry) {
    if (entry < 9) return placement.rotation()(entry % 3, entry / 3);
    return placement.translation()[entry - 9];
}

SX& entry_of(pin::InertiaTpl<SX>& inertia, int entry) {
    if (entry == 0) return inertia.mass();
    if (entry < 4) return inertia.lever()[entry - 1];
    return inertia.inertia().data()[entry - 4];
}

SX& entry_of(Model& model, const ModelNumber& number) {
    if (number.entry < 0) throw std::out_of_range("no such number of a model");
    switch (number.of) {
    case ModelNumber::Of::inertia:
        if (number.entry > 9) break;
        return entry_of(model.inertias.at(number.index), number.entry);
    case ModelNumber::Of::joint_placement:
        if (number.entry > 11) break;
        return entry_of(model.jointPlacements.at(number.index), number.entry);
    case ModelNumber::Of::frame_placement:
        if (number.entry > 11) break;
        return entry_of(model.frames.at(number.index).placement, number.entry);
    }
    throw std::out_of_range("no such number of a model");
}
}  // namespace

Tree::Tree(const std::string& serialized_model, const std::vector<ModelNumber>& given)
    : numbers(SX::sym("numbers", given.size())) {
    pin::Model source;
    std::istringstream stream(serialized_model);
    source.loadFromStringStream(stream);
    nq = source.nq;
    nv = source.nv;

    model.inertias.clear();
    model.jointPlacements.clear();
    model.frames.clear();
    copy_topology(source, model);

    std::vector<casadi_int> rows, columns;  // of A
    std::vector<double> values;
    std::vector<double> armature;
    for (pin::JointIndex id = 1; id < (pin::JointIndex)source.njoints; ++id) {
        const pin::JointModel& joint = source.joints[id];
        const auto* mimic = boost::get<pin::JointModelMimic>(&joint.toVariant());
        const int row = model.nv;
        append_joint(model, moving(joint), id);
        if (mimic) mimics.push_back({id, joint.idx_q(), mimic->scaling(), mimic->offset()});
        for (int k = 0; k < model.nqs[id]; ++k) source_q.push_back(mimic ? -1 : joint.idx_q() + k);
        for (int k = 0; k < model.nvs[id]; ++k) {
            rows.push_back(row + k);
            columns.push_back(joint.idx_v() + k);
            values.push_back(mimic ? mimic->scaling() : 1.);
            armature.push_back(mimic ? 0. : source.armature[joint.idx_v() + k]);
        }
    }
    A = SX::triplet(rows, columns, casadi::DM(values), model.nv, nv);
    model.armature.resize(model.nv);
    for (int k = 0; k < model.nv; ++k) model.armature[k] = armature[k];
    for (size_t k = 0; k < given.size(); ++k) entry_of(model, given[k]) = numbers((casadi_int)k);
}

std::vector<SX> Tree::inputs(std::vector<SX> own) const {
    if (!numbers.is_empty()) own.push_back(numbers);
    return own;
}

casadi::Function Tree::function(const std::string& name, const std::vector<SX>& own, const std::vector<SX>& outputs,
                                std::vector<std::string> names_in, const std::vector<std::string>& names_out) const {
    if (!numbers.is_empty()) names_in.push_back("numbers");
    return {name, inputs(own), outputs, names_in, names_out};
}

Data& Tree::scratch() const {
    if (!data) data = std::make_unique<Data>(model);
    return *data;
}

VectorX Tree::configuration(const SX& q) const {
    VectorX Q(model.nq);
    for (int k = 0; k < model.nq; ++k)
        if (source_q[k] >= 0) Q[k] = q(source_q[k]);
    for (const Mimic& mimic : mimics) {
        const int size = model.nqs[mimic.joint];
        const VectorX mimicked = to_eigen(q(casadi::Slice(mimic.idx_q, mimic.idx_q + size)));
        const auto& joint = boost::get<AnyJoint>(model.joints[mimic.joint].toVariant());
        Q.segment(model.idx_qs[mimic.joint], size) = scaled_configuration(joint, mimicked, mimic.scaling, mimic.offset);
    }
    return Q;
}

VectorX Tree::velocity(const SX& v) const { return to_eigen(mimics.empty() ? v : densify(mtimes(A, v))); }

SX Tree::force(const VectorX& T) const {
    const SX full = to_casadi(T);
    return mimics.empty() ? full : densify(mtimes(A.T(), full));
}

SX Tree::jacobian(const SX& J) const { return mimics.empty() ? J : densify(mtimes(J, A)); }

SX Tree::inertia(const SX& M) const { return mimics.empty() ? M : densify(mtimes(A.T(), mtimes(M, A))); }

std::shared_ptr<const Tree> load_tree(const std::string& serialized_model, const std::vector<ModelNumber>& given) {
    return std::make_shared<const Tree>(serialized_model, given);
}

int configuration_size(const Tree& tree) { return tree.nq; }
int velocity_size(const Tree& tree) { return tree.nv; }
int joint_count(const Tree& tree) { return tree.model.njoints; }
int frame_count(const Tree& tree) { return tree.model.nframes; }
}  // namespace mbocp
