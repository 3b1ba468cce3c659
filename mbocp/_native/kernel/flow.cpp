#include "flow.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace mbocp {

Flow::Flow(Function rate, Numbers numbers, Tableau tableau)
    : rate_(std::move(rate)), numbers_(std::move(numbers)), tableau_(std::move(tableau)) {
    const int num_inputs = numbers_.empty() ? 3 : 4;
    const auto& outputs = rate_->outputs;
    const std::size_t stages = tableau_.weights.size();
    if (rate_->num_inputs != num_inputs || outputs.size() != 2) throw std::invalid_argument("rate: inputs or outputs");
    nq_ = rate_->input_sizes[0], ns_ = rate_->input_sizes[1], nu_ = rate_->input_sizes[2];
    if (outputs[0].nnz() != nq_ || outputs[1].nnz() != ns_) throw std::invalid_argument("rate: sizes of the outputs");
    if (num_inputs == 4 && rate_->input_sizes[3] != static_cast<int>(numbers_.size()))
        throw std::invalid_argument("numbers: wrong length");
    if (tableau_.slopes.size() != stages || tableau_.nodes.size() != stages)
        throw std::invalid_argument("tableau: sizes");
    for (std::size_t i = 0; i < stages; ++i)
        if (tableau_.slopes[i].size() < i) throw std::invalid_argument("tableau: a row is too short");
    const std::size_t lanes = static_cast<std::size_t>(rate_->num_lanes), nx = static_cast<std::size_t>(nq_ + ns_);
    double* to = memory_.allocate(lanes * (nx * (2 + stages) + static_cast<std::size_t>(nu_)));
    x_ = to, at_ = x_ + lanes * nx, applied_ = at_ + lanes * nx, slopes_ = applied_ + lanes * nu_;
}

Numbers Flow::ends(const double* states, const FlowSteps& steps, int parts) {
    const int nx = state_size(), lanes = rate_->num_lanes;
    Numbers found(states, states + static_cast<std::size_t>(steps.count) * nx);
    for (int begin = 0; begin < steps.count; begin += lanes) {
        const int count = std::min(lanes, steps.count - begin);
        double* own = found.data() + static_cast<std::size_t>(begin) * nx;
        std::copy_n(own, count * nx, x_);
        const double* controls = steps.controls + static_cast<std::size_t>(begin) * steps.size;
        for (int part = 0; part < parts; ++part)
            step(lanes, count, controls, steps.size, steps.lengths + begin, part, parts);
        std::copy_n(x_, count * nx, own);
    }
    return found;
}

Numbers Flow::chain(const double* state, const FlowSteps& steps, int parts, const FlowFeedback* feedback,
                    Numbers& carried) {
    const int nx = state_size();
    Numbers found;
    found.reserve(static_cast<std::size_t>(steps.count) * nx);
    std::copy_n(state, nx, x_);
    for (int n = 0; n < steps.count; ++n) {
        const double* controls = steps.controls + static_cast<std::size_t>(n) * steps.size;
        if (feedback) answer(*feedback, n, steps, carried), controls = answered_.data();
        for (int part = 0; part < parts; ++part) step(1, 1, controls, steps.size, steps.lengths + n, part, parts);
        found.insert(found.end(), x_, x_ + nx);
    }
    return found;
}

// One step of the method over a part of a step, of the first `count` lanes.
void Flow::step(int lanes, int count, const double* controls, int size, const double* lengths, int part, int parts) {
    const int nx = state_size(), stages = static_cast<int>(tableau_.weights.size());
    const auto add_slopes = [&](const Numbers& weights, int until, double* to) {
        for (int lane = 0; lane < count; ++lane) {
            const double h = lengths[lane] / parts;
            const double* slope = slopes_ + lane * nx;
            for (int i = 0; i < nx; ++i) {
                double sum = 0.0;
                for (int j = 0; j < until; ++j)
                    if (weights[j] != 0.0) sum += weights[j] * slope[j * lanes * nx + i];
                to[lane * nx + i] = x_[lane * nx + i] + h * sum;
            }
        }
    };
    for (int stage = 0; stage < stages; ++stage) {
        const double share = (part + tableau_.nodes[stage]) / parts;
        for (int lane = 0; lane < count; ++lane)
            for (int i = 0; i < nu_; ++i) {
                double value = 0.0;
                for (int at = size - nu_ + i; at >= 0; at -= nu_) value = controls[lane * size + at] + share * value;
                applied_[lane * nu_ + i] = value;
            }
        add_slopes(tableau_.slopes[stage], stage, at_);
        find_slopes(lanes, count, stage);
    }
    add_slopes(tableau_.weights, stages, x_);
}

void Flow::find_slopes(int lanes, int count, int stage) {
    const int nx = state_size();
    double* to = slopes_ + static_cast<std::size_t>(stage) * lanes * nx;
    if (lanes == 1) {
        rate_->arg[0] = at_, rate_->arg[1] = at_ + nq_, rate_->arg[2] = applied_;
        if (!numbers_.empty()) rate_->arg[3] = numbers_.data();
        if (!rate_->call()) return void(std::fill_n(to, nx, std::nan("")));
        std::copy_n(rate_->res[0], nq_, to);
        std::copy_n(rate_->res[1], ns_, to + nq_);
        return;
    }
    const double *q[most_lanes], *s[most_lanes], *u[most_lanes];
    for (int lane = 0; lane < lanes; ++lane) {
        const int own = std::min(lane, count - 1);
        q[lane] = at_ + own * nx, s[lane] = q[lane] + nq_, u[lane] = applied_ + own * nu_;
    }
    rate_->set(0, q), rate_->set(1, s), rate_->set(2, u);
    if (!numbers_.empty()) rate_->share(3, numbers_.data());
    if (!rate_->call_in_lanes(count)) return void(std::fill_n(to, lanes * nx, std::nan("")));
    const double *dq = rate_->values(0), *ds = rate_->values(1);
    for (int lane = 0; lane < count; ++lane) {
        for (int i = 0; i < nq_; ++i) to[lane * nx + i] = dq[i * lanes + lane];
        for (int i = 0; i < ns_; ++i) to[lane * nx + nq_ + i] = ds[i * lanes + lane];
    }
}

void Flow::answer(const FlowFeedback& feedback, int n, const FlowSteps& steps, Numbers& carried) {
    StageFunction& difference = *feedback.difference;
    const int nv = difference.outputs[0].nnz(), width = feedback.width;
    const double* planned = feedback.planned + static_cast<std::size_t>(n) * (nq_ + nv);
    difference.arg[0] = planned, difference.arg[1] = x_;
    if (!numbers_.empty()) difference.arg[2] = numbers_.data();
    away_.assign(static_cast<std::size_t>(2 * nv), std::nan(""));
    if (difference.call()) std::copy_n(difference.res[0], nv, away_.begin());
    for (int i = 0; i < nv; ++i) away_[nv + i] = x_[nq_ + i] - planned[nq_ + i];
    if (width > 2 * nv) away_.insert(away_.end(), carried.begin(), carried.end());
    const double* gains = feedback.gains + static_cast<std::size_t>(n) * steps.size * width;
    const double* controls = steps.controls + static_cast<std::size_t>(n) * steps.size;
    answered_.assign(controls, controls + steps.size);
    std::fill(carried.begin(), carried.end(), 0.0);
    for (int i = 0; i < steps.size; ++i) {
        double moved = 0.0;
        for (int j = 0; j < width; ++j) moved += gains[i * width + j] * away_[j];
        answered_[i] += moved, carried[i % nu_] += moved;
    }
}

}  // namespace mbocp
