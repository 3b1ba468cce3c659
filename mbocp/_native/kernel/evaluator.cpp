#include "evaluator.hpp"

#include <algorithm>
#include <cmath>

namespace mbocp {

namespace {

double square(double v) { return v * v; }

// All that a kind's `complete` gives but the cost, from the memory of one of its stages on.
Places places_of(const Stage& s) {
    const Kind& k = *s.kind;
    const StageFunction& f = *k.complete;
    const double* const gradients[] = {s.lw, s.ls};
    Places places;
    for (int i = 0; i < f.outputs[0].nnz(); ++i) places.push_back({f.first[0] + i, f.outputs[0].row[i]});
    for (std::size_t i = 0; i < k.to_gradient.size(); ++i) {
        const Target& t = k.to_gradient[i];
        places.push_back(
            {f.first[3] + static_cast<int>(i), static_cast<int>(gradients[t.block] - s.begin()) + t.offset});
    }
    return places;
}

}  // namespace

// Adds a row to the violation (l1, the programme's scaling) and to the squared primal norm (the reported scaling).
struct Evaluator::Violations {
    Evaluation& e;
    double squared = 0;

    void add(double value, double scale, int stage, int row) {
        e.violation += std::abs(value);
        squared += square(value * scale);
        if (!(std::abs(value * scale) <= e.worst))
            e.worst = std::abs(value * scale), e.worst_stage = stage, e.worst_row = row;
    }
};

Evaluator::Evaluator(const Problem& problem, const Iterate& iterate, Data& data, Step& step, Barrier& barrier)
    : problem_(problem), iterate_(iterate), data_(data), step_(step), barrier_(barrier),
      scaled_m_(iterate.m.size(), 0.0), zeros_(static_cast<std::size_t>(problem.max_nw + problem.max_ns), 0.0),
      costs_(static_cast<std::size_t>(problem.N), 0.0), groups_(problem.groups(&Kind::complete)) {
    for (const Kind& kind : problem.kinds()) {
        Places places;
        for (int n = 0; n < problem.N && places.empty(); ++n)
            if (&problem.kind(n) == &kind) places = places_of(data[n]), step.add_places(n, places);
        scatters_.emplace_back(places, kind.complete->first.back() + kind.complete->outputs.back().nnz());
    }
}

bool Evaluator::evaluate_group(const Group& group, const double* multipliers, int thread) {
    const Kind& k = problem_.kind(group);
    StageFunction& f = k.complete->of(thread);
    const bool ok = problem_.call(f, group, iterate_, multipliers);
    double* memories[most_lanes];
    for (int i = 0; i < most_lanes; ++i) memories[i] = data_[group.stage[i]].begin();
    scatters_[static_cast<std::size_t>(group.kind)].apply(f.all_values(), f.num_lanes, memories);
    for (int i = 0; i < group.count; ++i) {
        const int n = group.stage[i];
        const Stage& s = data_[n];
        costs_[n] = f.outputs[1].nnz() ? f.values(1)[i] : 0.0;
        step_.receive(n);
        dense::copy(s.lw, s.gw, k.nw());
        dense::copy(s.ls, s.gs, k.ns());
        step_.add_jacobian_transposed(n, iterate_.m.data() + problem_.m_offset[n], s.gw, s.gs);
    }
    return ok;
}

void Evaluator::add_up(const Group& group, Violations& violations) const {
    const Kind& k = problem_.kind(group);
    for (int i = 0; i < group.count; ++i) {
        const int n = group.stage[i];
        const double* c = data_[n].c;
        violations.e.cost += costs_[n];
        for (int row = 0; row < k.nc(); ++row) violations.add(c[row], k.scale_c[row], n, row);
    }
}

// Squared norm of the stationarity conditions, and their largest defect before it is scaled; that in x_n collects from
// stage n and from stage n + 1.
double Evaluator::stationarity(double& largest) const {
    const int nd = problem_.ndx;
    const Limits& limits = barrier_.limits();
    double sum = 0;
    for (int n = 0; n < problem_.N; ++n) {
        const Stage& s = data_[n];
        const Kind& k = *s.kind;
        const double* after = n + 1 < problem_.N ? data_[n + 1].gs : data_.end.r_x.data();
        const double* of_x = limits.empty() ? zeros_.data() : limits.state_gradient(n);
        const double* of_u = limits.empty() ? zeros_.data() : limits.control_gradient(n);
        const auto add = [&](double defect, double scale) {
            largest = std::max(largest, std::abs(defect)), sum += square(defect * scale);
        };
        for (int i = 0; i < nd; ++i) add(s.gw[i] + after[i] + of_x[i], 1.0);
        for (int i = 0; i < k.ny; ++i) add(s.gw[nd + i], 1.0);
        for (int i = 0; i < k.nu; ++i) add(s.gs[nd + i] + of_u[i], k.scale_ru[i]);
    }
    return sum;
}

Evaluation Evaluator::evaluate(double share) {
    const Numbers& m = iterate_.m;
    const int N = problem_.N, ng = problem_.ng;
    const double* multipliers = m.data();
    if (share != 1.0) {
        for (std::size_t i = 0; i < m.size(); ++i) scaled_m_[i] = share * m[i];
        multipliers = scaled_m_.data();
    }
    Evaluation e;
    std::atomic<bool> all_ok{true};
    const auto prepare = [&](int thread) {
        for (const Kind& kind : problem_.kinds()) problem_.prepare(kind.complete->of(thread), true);
    };
    problem_.crew().share(section_, static_cast<int>(groups_.size()), true, prepare,
                          [&](int thread, int first, int last) {
                              for (int i = first; i < last; ++i)
                                  if (!evaluate_group(groups_[i], multipliers, thread)) all_ok = false;
                          });
    bool ok = all_ok;
    Violations violations{e};
    for (const Group& group : groups_) add_up(group, violations);
    ok = data_.end.evaluate(problem_, iterate_, e) && ok;
    for (int i = 0; i < ng; ++i) violations.add(data_.end.g[i], 1.0, -1, i);
    if (!barrier_.empty()) {
        ok = barrier_.evaluate(iterate_) && ok;
        const Limits& limits = barrier_.limits();
        for (int n = 0; n < N; ++n) {
            const auto [first, u, path, end] = limits.of_stage(n);
            for (int i = first; i < end; ++i)
                violations.add(barrier_.defect()[i], 1.0, n, problem_.kind(n).nc() + i - first);
        }
        for (int i = limits.first_guard(); i < limits.num_rows(); ++i)
            violations.add(barrier_.defect()[i], 1.0, -1, ng + i - limits.first_guard());
    }
    const double dual = stationarity(e.barrier_error);
    e.primal = std::sqrt(violations.squared), e.dual = std::sqrt(dual);
    e.residual = std::sqrt(violations.squared + dual), e.objective = e.cost;
    e.barrier_error = std::max(e.barrier_error, e.worst);
    e.finite = ok && std::isfinite(e.residual) && std::isfinite(e.cost);
    last_ = e;
    return weigh(barrier_.parameter());
}

Evaluation Evaluator::weigh(double parameter) {
    if (barrier_.empty()) return last_;
    barrier_.set_parameter(parameter);
    Evaluation e = last_;
    barrier_.finish(e);
    return e;
}

}  // namespace mbocp
