#include "evaluator.hpp"

#include <algorithm>
#include <cmath>

namespace mbocp {

namespace {

double square(double v) { return v * v; }

// All that `complete` gives but the cost, from the memory of a stage on.
Scatter scatter_of(const Stage& s, const Step& step) {
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
    step.add_places(places);
    return Scatter(std::move(places), f.first.back() + f.outputs.back().nnz());
}

}  // namespace

// Adds rows to the violation (l1, the programme's scaling) and to the squared primal norm (the reported scaling).
struct Evaluator::Violations {
    Evaluation& e;
    double squared = 0;

    void add(double value, double scale, int stage, int row) {
        e.violation += std::abs(value);
        squared += square(value * scale);
        compare(value * scale, stage, row);
    }
    void add(int rows, const double* values, const double* scale, int stage) {
        dense::Vec sizes = {};
        for (int i = 0; i < rows; i += dense::width) {
            const dense::Vec v = dense::first_of(values + i, rows - i);
            sizes += v < 0.0 ? -v : v;
        }
        const double squares = dense::weighted_squares(rows, values, scale);
        e.violation += dense::sum_of(sizes), squared += squares;
        if (squares < square(e.worst)) return;  // none of them is worse
        for (int i = 0; i < rows; ++i) compare(values[i] * scale[i], stage, i);
    }

    // Of limits, whose rows come after those of a stage and of the end.
    void add(const Barrier& barrier, int num_stages, int num_stage_rows, int num_end_rows) {
        const Numbers& defect = barrier.defect();
        const Limits& limits = barrier.limits();
        const int size = limits.num_rows();
        double sum = 0;
        for (int i = 0; i < size; ++i) sum += std::abs(defect[i]);
        const double squares = dense::dot(size, defect.data(), defect.data());
        e.violation += sum, squared += squares;
        if (std::isfinite(squares) && dense::largest(size, defect.data()) <= e.worst) return;  // none of them is worse
        for (int n = 0; n < num_stages; ++n) {
            const auto [first, u, path, end] = limits.of_stage(n);
            for (int i = first; i < end; ++i) compare(defect[i], n, num_stage_rows + i - first);
        }
        for (int i = limits.first_guard(); i < size; ++i)
            compare(defect[i], -1, num_end_rows + i - limits.first_guard());
    }

private:
    void compare(double scaled, int stage, int row) {
        if (!(std::abs(scaled) <= e.worst)) e.worst = std::abs(scaled), e.worst_stage = stage, e.worst_row = row;
    }
};

Evaluator::Evaluator(const Problem& problem, const Iterate& iterate, Data& data, Step& step, Barrier& barrier)
    : problem_(problem), iterate_(iterate), data_(data), step_(step), barrier_(barrier),
      scaled_m_(iterate.m.size(), 0.0),
      zeros_(static_cast<std::size_t>(problem.kind().nw() + problem.kind().ns()), 0.0),
      costs_(static_cast<std::size_t>(problem.N), 0.0), groups_(problem.groups(&Kind::complete)),
      scatter_(scatter_of(data[0], step)) {}

bool Evaluator::evaluate_group(const Group& group, const double* multipliers, int thread) {
    const Kind& k = problem_.kind();
    StageFunction& f = k.complete->of(thread);
    const bool ok = problem_.call(f, group, iterate_, multipliers);
    double* memories[most_lanes];
    for (int i = 0; i < f.num_lanes; ++i) memories[i] = data_[group.stage[i]].begin();
    scatter_.apply(f.all_values(), f.num_lanes, group.count, memories);
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
    const Kind& k = problem_.kind();
    for (int i = 0; i < group.count; ++i) {
        const int n = group.stage[i];
        violations.e.cost += costs_[n];
        violations.add(k.nc(), data_[n].c, k.scale_c.data(), n);
    }
}

// Squared norm of the stationarity conditions, and their largest defect before it is scaled; that in x_n collects from
// stage n and from stage n + 1.
double Evaluator::stationarity(double& largest) const {
    const int nd = problem_.ndx;
    const Limits& limits = barrier_.limits();
    dense::Vec squares = {}, sizes = {};
    const auto add = [&](int count, auto defect_at, auto scale_at) {
        for (int i = 0; i < count; i += dense::width) {
            const dense::Vec defect = defect_at(i, count - i), scaled = defect * scale_at(i, count - i);
            const dense::Vec size = defect < 0.0 ? -defect : defect;
            sizes = size > sizes ? size : sizes, squares += scaled * scaled;
        }
    };
    const auto one = [](int, int) { return 1.0; };
    for (int n = 0; n < problem_.N; ++n) {
        const Stage& s = data_[n];
        const Kind& k = *s.kind;
        const double* after = n + 1 < problem_.N ? data_[n + 1].gs : data_.end.r_x.data();
        const double* of_x = limits.empty() ? zeros_.data() : limits.state_gradient(n);
        const double* of_u = limits.empty() ? zeros_.data() : limits.control_gradient(n);
        const auto in_x = [&](int i, int left) {
            return dense::first_of(s.gw + i, left) + dense::first_of(after + i, left) + dense::first_of(of_x + i, left);
        };
        const auto in_y = [&](int i, int left) { return dense::first_of(s.gw + nd + i, left); };
        const auto in_u = [&](int i, int left) {
            return dense::first_of(s.gs + nd + i, left) + dense::first_of(of_u + i, left);
        };
        add(nd, in_x, one), add(k.ny, in_y, one);
        add(k.nu, in_u, [&](int i, int left) { return dense::first_of(k.scale_ru.data() + i, left); });
    }
    largest = std::max(largest, dense::largest_of(sizes));
    return dense::sum_of(squares);
}

Evaluation Evaluator::evaluate(double share) {
    const Numbers& m = iterate_.m;
    const int ng = problem_.ng;
    const double* multipliers = m.data();
    if (share != 1.0) {
        for (std::size_t i = 0; i < m.size(); ++i) scaled_m_[i] = share * m[i];
        multipliers = scaled_m_.data();
    }
    Evaluation e;
    std::atomic<bool> all_ok{true};
    const auto prepare = [&](int thread) { problem_.prepare(problem_.kind().complete->of(thread), true); };
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
        violations.add(barrier_, problem_.N, problem_.kind().nc(), ng);
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
    return finished();
}

Evaluation Evaluator::aim(double parameter, bool is_curved) {
    barrier_.aim(parameter, is_curved);
    return finished();
}

Evaluation Evaluator::finished() const {
    Evaluation e = last_;
    if (!barrier_.empty()) barrier_.finish(e);
    return e;
}

}  // namespace mbocp
