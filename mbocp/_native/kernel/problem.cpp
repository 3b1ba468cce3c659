#include "problem.hpp"

#include <algorithm>
#include <stdexcept>

#include "iterate.hpp"

namespace mbocp {

Problem::Problem(int num_stages, Kind kind, Terminal end, Function retract, Function difference, int num_threads)
    : N(num_stages), nx(kind.nx), ndx(kind.ndx), ng(end.ng), terminal(std::move(end)), kind_(std::move(kind)),
      retract_(std::move(retract)), difference_(std::move(difference)) {
    if (N < 1) throw std::invalid_argument("a programme needs at least one stage");
    kind_.prepare();
    nd = is_structured() ? kind_.structure->nd() : ndx;
    check_output(terminal.values, 1, ng, 1, "terminal values");
    check_output(terminal.complete, 2, ng, ndx, "terminal complete");
    check_output(retract_, 0, nx, 1, "retract");
    check_output(difference_, 0, ndx, 1, "difference");
    for (int n = 0; n <= N; ++n) {
        y_offset.push_back(n * kind_.ny), u_offset.push_back(n * kind_.nu);
        m_offset.push_back(n * kind_.nc()), r_offset.push_back(n * kind_.nr);
    }
    bool may_share = true;
    for (const Function& f : {kind_.complete, kind_.values}) may_share = f->copy_for(num_threads) && may_share;
    crew_ = std::make_unique<Crew>(may_share ? num_threads : 1);
    rho_.assign(r_offset.back(), 0.0);
    scaled_.assign(static_cast<std::size_t>(ndx) * most_lanes, 0.0);
}

void Problem::set_parameters(Given of_all, Given of_stages, Given of_end) {
    if (static_cast<int>(of_stages.size) != r_offset.back())
        throw std::invalid_argument("stage parameters: wrong length");
    const auto set = [](Numbers& to, Given given) {
        to.resize(given.size + 1, 0.0);  // one more: functions may ask for a pointer of none
        std::copy(given.at, given.at + given.size, to.begin());
    };
    set(theta, of_all), set(rho_, of_stages), set(rho_terminal, of_end);
}

bool Problem::call(StageFunction& f, int n, const Point& at, const double* multipliers) const {
    f.arg[0] = at.x.data() + x_offset(n);
    f.arg[1] = f.arg[0] + nx;
    f.arg[2] = at.y.data() + y_offset[n];
    f.arg[3] = at.u.data() + u_offset[n];
    int next = 4;
    if (multipliers) f.arg[next++] = multipliers + m_offset[n];
    f.arg[next++] = theta.data();
    f.arg[next] = rho_.data() + r_offset[n];
    return f.call();
}

Groups Problem::groups(Function Kind::* function) const {
    const int num_lanes = (kind_.*function)->num_lanes;
    Groups out;
    for (int first = 0; first < N; first += num_lanes) {
        Group group{std::min(num_lanes, N - first), {}};
        for (int i = 0; i < most_lanes; ++i) group.stage[i] = first + std::min(i, group.count - 1);
        out.push_back(group);
    }
    return out;
}

void Problem::prepare(StageFunction& f, bool has_multipliers) const { f.share(has_multipliers ? 5 : 4, theta.data()); }

bool Problem::call(StageFunction& f, const Group& group, const Point& at, const double* multipliers) const {
    const double* from[most_lanes];
    int next = 0;
    const auto pass = [&](auto of_stage) {
        for (int i = 0; i < f.num_lanes; ++i) from[i] = of_stage(group.stage[i]);
        f.set(next++, from);
    };
    pass([&](int n) { return at.x.data() + x_offset(n); });
    pass([&](int n) { return at.x.data() + x_offset(n + 1); });
    pass([&](int n) { return at.y.data() + y_offset[n]; });
    pass([&](int n) { return at.u.data() + u_offset[n]; });
    if (multipliers) pass([&](int n) { return multipliers + m_offset[n]; });
    ++next;  // theta
    pass([&](int n) { return rho_.data() + r_offset[n]; });
    return f.call_in_lanes(group.count);
}

bool Problem::retract_nodes(const Numbers& x, const Numbers& dx, double alpha, Numbers& x_next) const {
    StageFunction& f = *retract_;
    const Pattern& pattern = f.outputs[0];
    const double *at[most_lanes], *by[most_lanes];
    bool ok = true;
    for (int node = 1; node <= N; node += f.num_lanes) {
        for (int lane = 0; lane < f.num_lanes; ++lane) {
            const int own = std::min(node + lane, N);
            double* scaled = scaled_.data() + lane * ndx;
            const double* step = dx.data() + dx_offset(own);
            for (int i = 0; i < ndx; ++i) scaled[i] = alpha * step[i];
            at[lane] = x.data() + x_offset(own), by[lane] = scaled;
        }
        f.set(0, at), f.set(1, by);
        ok = f.call_in_lanes(N + 1 - node) && ok;
        const double* values = f.values(0);
        for (int lane = 0; lane < f.num_lanes && node + lane <= N; ++lane) {
            double* next = x_next.data() + x_offset(node + lane);
            for (int i = 0; i < pattern.nnz(); ++i) next[pattern.row[i]] = values[i * f.num_lanes + lane];
        }
    }
    return ok;
}

bool Problem::retract(const double* x, const double* dx, double alpha, double* x_next) const {
    for (int i = 0; i < ndx; ++i) scaled_[i] = alpha * dx[i];
    retract_->arg[0] = x;
    retract_->arg[1] = scaled_.data();
    if (!retract_->call()) return false;
    const Pattern& pattern = retract_->outputs[0];
    for (int i = 0; i < pattern.nnz(); ++i) x_next[pattern.row[i]] = retract_->res[0][i];
    return true;
}

bool Problem::difference(const double* x, const double* x_moved, double* dx) const {
    difference_->arg[0] = x, difference_->arg[1] = x_moved;
    if (!difference_->call()) return false;
    std::fill(dx, dx + ndx, 0.0);
    const Pattern& pattern = difference_->outputs[0];
    for (int i = 0; i < pattern.nnz(); ++i) dx[pattern.row[i]] = difference_->res[0][i];
    return true;
}

void Increment::add(const Increment& other) {
    const auto add = [](Numbers& to, const Numbers& from) {
        for (std::size_t i = 0; i < to.size(); ++i) to[i] += from[i];
    };
    add(dx, other.dx), add(dy, other.dy), add(du, other.du), add(dm, other.dm), add(deta, other.deta);
}

void Residual::add(double factor, const Residual& other) {
    const auto add = [&](Numbers& to, const Numbers& from) {
        for (std::size_t i = 0; i < to.size(); ++i) to[i] += factor * from[i];
    };
    add(c, other.c), add(w, other.w), add(s, other.s), add(x_terminal, other.x_terminal), add(g, other.g);
}

}  // namespace mbocp
