// Limits in the Newton step: see limits.hpp.
#include "limits.hpp"

#include <cmath>
#include <limits>
#include <stdexcept>

#include "programme.hpp"

namespace mbocp {
using dense::padded;

namespace {

constexpr double least_rest = 1e-2;       // of a distance to a bound that a step has to leave: 1 - tau, or mu
constexpr double most_off_centre = 1e10;  // z (s - lower) / mu stays between this and its inverse

bool has(double bound) { return std::isfinite(bound); }

// -mu log of the distances, many factors to a logarithm.
struct Barrier {
    double product = 1.0, sum = 0.0;
    bool ok = true;

    void add(double distance) {
        ok = ok && distance > 0.0;
        product *= distance;
        if (product < 1e-200 || product > 1e200) sum += std::log(product), product = 1.0;
    }
    double value(double mu) const { return -mu * (sum + std::log(product)); }
};

}  // namespace

void Programme::set_limits(const Bounds& bounds, Function path, Function guard) {
    if (nx_ != ndx_) throw std::invalid_argument("limits: states must be plain vectors");
    Limits l;
    const auto chosen = [](const Numbers& lower, const Numbers& upper, int size, const char* name) {
        if (static_cast<int>(lower.size()) != size || lower.size() != upper.size())
            throw std::invalid_argument(std::string("limits of ") + name + ": wrong length");
        std::vector<int> found;
        for (int i = 0; i < size; ++i) {
            if (!has(lower[i]) && !has(upper[i])) continue;
            if (!(lower[i] < upper[i])) throw std::invalid_argument(std::string("limits of ") + name + ": no room");
            found.push_back(i);
        }
        return found;
    };
    const int nu = kinds_[0].nu;
    for (const auto& kind : kinds_)
        if (kind.nu != nu) throw std::invalid_argument("limits: kinds differ in the number of controls");
    l.x = chosen(bounds.x_lower, bounds.x_upper, nx_, "states");
    l.u = chosen(bounds.u_lower, bounds.u_upper, nu, "controls");
    l.nh = static_cast<int>(bounds.path_lower.size()), l.num_guards = bounds.num_guards;
    if (l.nh && !path) throw std::invalid_argument("limits: the path functions are missing");
    if (l.num_guards && !guard) throw std::invalid_argument("limits: the guards are missing");
    if (is_structured_ && (l.nh || l.num_guards || !l.x.empty()))
        throw std::invalid_argument("limits: where stages have a structure, only controls can have any");
    l.path = std::move(path), l.guard = std::move(guard);
    l.rows = static_cast<int>(l.x.size() + l.u.size()) + l.nh;
    l.total = N * l.rows + l.num_guards;
    Numbers lower, upper;
    for (const int i : l.x) lower.push_back(bounds.x_lower[i]), upper.push_back(bounds.x_upper[i]);
    for (const int i : l.u) lower.push_back(bounds.u_lower[i]), upper.push_back(bounds.u_upper[i]);
    lower.insert(lower.end(), bounds.path_lower.begin(), bounds.path_lower.end());
    upper.insert(upper.end(), bounds.path_upper.begin(), bounds.path_upper.end());
    for (int n = 0; n < N; ++n) {
        l.lower.insert(l.lower.end(), lower.begin(), lower.end());
        l.upper.insert(l.upper.end(), upper.begin(), upper.end());
    }
    l.lower.resize(l.total, 0.0), l.upper.resize(l.total, std::numeric_limits<double>::infinity());
    for (Numbers* v : {&l.defect, &l.sigma, &l.force, &l.ds, &l.dz_lower, &l.dz_upper, &l.slack_trial, &l.h, &slack,
                       &z_lower, &z_upper})
        v->assign(l.total, 0.0);
    l.lambda.assign(std::max(l.nh, l.num_guards), 0.0);
    const std::size_t px = padded(ndx_), nodes = l.nh ? N : l.num_guards ? 1 : 0;
    l.of_x.assign(static_cast<std::size_t>(N) * ndx_, 0.0), l.of_u.assign(u.size(), 0.0);
    l.J.assign(static_cast<std::size_t>(l.nh) * N * px, 0.0), l.guard_J.assign(l.num_guards * px, 0.0);
    l.H.assign(nodes * px * px, 0.0), l.B = l.H;
    limits_ = std::move(l);
}

namespace {

// Calls a function (..., m, ...) -> h, dh_dx, upper Hessian of m'h; values into h, and, where J and H are not null,
// derivatives into J and added to H, both with leading dimension px.
bool evaluate_rows(StageFunction& f, int px, double* h, double* J, double* H) {
    const bool ok = f.call();
    const auto &values = f.outputs[0], &slopes = f.outputs[1], &curvature = f.outputs[2];
    for (int k = 0; k < values.nnz(); ++k) h[values.row[k]] = f.res[0][k];
    if (!J) return ok;
    for (int k = 0; k < slopes.nnz(); ++k) J[slopes.row[k] * px + slopes.column[k]] = f.res[1][k];
    for (int k = 0; k < curvature.nnz(); ++k) {
        const int i = curvature.row[k], j = curvature.column[k];
        H[i * px + j] += f.res[2][k];
        if (i != j) H[j * px + i] += f.res[2][k];
    }
    return ok;
}

}  // namespace

// Path functions at the end of a stage's step.
bool Programme::evaluate_path(int n, const Numbers& x_now, double* h, double* J, double* H) {
    Limits& l = limits_;
    const int first = n * l.rows + l.rows - l.nh;
    for (int i = 0; i < l.nh; ++i) l.lambda[i] = z_upper[first + i] - z_lower[first + i];
    l.path->arg[0] = x_now.data() + static_cast<std::size_t>(n + 1) * nx_;
    l.path->arg[1] = l.lambda.data();
    l.path->arg[2] = nullptr;  // zeros: what of a velocity a control prescribes is not limited
    l.path->arg[3] = theta_.data();
    return evaluate_rows(*l.path, padded(ndx_), h, J, H);
}

// Guards of the end condition.
bool Programme::evaluate_guard(const Numbers& x_now, double* h, double* J, double* H) {
    Limits& l = limits_;
    const int first = N * l.rows;
    for (int i = 0; i < l.num_guards; ++i) l.lambda[i] = z_upper[first + i] - z_lower[first + i];
    l.guard->arg[0] = x_now.data() + static_cast<std::size_t>(N) * nx_;
    l.guard->arg[1] = l.lambda.data();
    l.guard->arg[2] = rho_terminal_.data();
    return evaluate_rows(*l.guard, padded(ndx_), h, J, H);
}

// Values, defects and derivatives of all rows at the iterate.
bool Programme::evaluate_limits() {
    Limits& l = limits_;
    const int nd = ndx_, px = padded(nd), nlx = static_cast<int>(l.x.size()), nlu = static_cast<int>(l.u.size());
    bool ok = true;
    std::fill(l.of_x.begin(), l.of_x.end(), 0.0), std::fill(l.of_u.begin(), l.of_u.end(), 0.0);
    std::fill(l.H.begin(), l.H.end(), 0.0);
    for (int n = 0; n < N; ++n) {
        const int first = n * l.rows;
        double *h = l.h.data() + first, *of_x = l.of_x.data() + static_cast<std::size_t>(n) * nd;
        const double* xn = x.data() + static_cast<std::size_t>(n + 1) * nx_;
        const auto lambda = [&](int i) { return z_upper[first + i] - z_lower[first + i]; };
        for (int i = 0; i < nlx; ++i) h[i] = xn[l.x[i]], of_x[l.x[i]] += lambda(i);
        for (int i = 0; i < nlu; ++i) {
            h[nlx + i] = u[u_offset[n] + l.u[i]];
            l.of_u[u_offset[n] + l.u[i]] += lambda(nlx + i);
        }
        if (l.nh) {
            double* J = l.J.data() + static_cast<std::size_t>(n) * l.nh * px;
            ok = evaluate_path(n, x, h + nlx + nlu, J, l.H.data() + static_cast<std::size_t>(n) * px * px) && ok;
            for (int i = 0; i < l.nh; ++i) dense::axpy(nd, lambda(nlx + nlu + i), J + i * px, of_x);
        }
    }
    if (l.num_guards) {
        const int first = N * l.rows;
        ok = evaluate_guard(x, l.h.data() + first, l.guard_J.data(), l.H.data() + l.H.size() - px * px) && ok;
        for (int i = 0; i < l.num_guards; ++i)
            dense::axpy(nd, z_upper[first + i] - z_lower[first + i], l.guard_J.data() + i * px,
                        l.of_x.data() + static_cast<std::size_t>(N - 1) * nd);
    }
    for (int i = 0; i < l.total; ++i) l.defect[i] = l.h[i] - slack[i];
    return ok;
}

void Programme::start_limits(double barrier, double inside) {
    Limits& l = limits_;
    limits_.barrier = barrier;
    evaluate_limits();
    for (int i = 0; i < l.total; ++i) {
        const double lower = l.lower[i], upper = l.upper[i], gap = upper - lower;
        const auto margin = [&](double bound) {
            return std::min(inside * std::max(1.0, std::abs(bound)), inside * gap);
        };
        double s = l.h[i];
        if (has(lower)) s = std::max(s, lower + margin(lower));
        if (has(upper)) s = std::min(s, upper - margin(upper));
        slack[i] = s;
        z_lower[i] = has(lower) ? barrier / (s - lower) : 0.0;
        z_upper[i] = has(upper) ? barrier / (upper - s) : 0.0;
    }
}

Evaluation Programme::weigh(double barrier) {
    Limits& l = limits_;
    l.barrier = barrier;
    backward_done_ = factorised_ = residual_known_ = false;
    for (int i = 0; i < l.total; ++i) {
        double sigma = 0, force = 0;
        if (has(l.lower[i])) sigma += z_lower[i] / (slack[i] - l.lower[i]), force -= barrier / (slack[i] - l.lower[i]);
        if (has(l.upper[i])) sigma += z_upper[i] / (l.upper[i] - slack[i]), force += barrier / (l.upper[i] - slack[i]);
        l.sigma[i] = sigma, l.force[i] = force + sigma * l.defect[i];
    }
    const int nd = ndx_, px = padded(nd);
    const auto add_outer = [&](double weight, const double* row, double* B) {
        for (int i = 0; i < nd; ++i)
            if (row[i] != 0.0) dense::axpy(nd, weight * row[i], row, B + i * px);
    };
    l.B = l.H;
    for (int n = 0; l.nh && n < N; ++n)
        for (int i = 0; i < l.nh; ++i)
            add_outer(l.sigma[n * l.rows + l.rows - l.nh + i],
                      l.J.data() + (static_cast<std::size_t>(n) * l.nh + i) * px,
                      l.B.data() + static_cast<std::size_t>(n) * px * px);
    for (int i = 0; i < l.num_guards; ++i)
        add_outer(l.sigma[N * l.rows + i], l.guard_J.data() + i * px, l.B.data() + l.B.size() - px * px);
    Evaluation e = last_;
    finish_evaluation(e);
    return e;
}

// What of an evaluation depends on the barrier parameter.
void Programme::finish_evaluation(Evaluation& e) const {
    const Limits& l = limits_;
    Barrier barrier;
    double squared = 0;
    for (int i = 0; i < l.total; ++i) {
        const auto add = [&](double distance, double z) {
            const double product = distance * z;
            barrier.add(distance);
            squared += product * product;
            e.barrier_error = std::max(e.barrier_error, std::abs(product - l.barrier));
        };
        if (has(l.lower[i])) add(slack[i] - l.lower[i], z_lower[i]);
        if (has(l.upper[i])) add(l.upper[i] - slack[i], z_upper[i]);
    }
    e.objective = e.cost + barrier.value(l.barrier);
    e.complementarity = std::sqrt(squared);
    e.dual = std::hypot(e.dual, e.complementarity);
    e.residual = std::hypot(e.primal, e.dual);
    e.finite = e.finite && barrier.ok && std::isfinite(e.residual) && std::isfinite(e.objective);
}

void Programme::add_limit_gradients(Residual& out) const {
    const Limits& l = limits_;
    const int nd = ndx_, px = padded(nd), nlx = static_cast<int>(l.x.size()), nlu = static_cast<int>(l.u.size());
    for (int n = 0; n < N; ++n) {
        const double* force = l.force.data() + n * l.rows;
        double* w = out.w.data() + m_offset[n];
        double* s = out.s.data() + u_offset[n] + (n + 1) * nd;
        for (int i = 0; i < nlx; ++i) w[l.x[i]] += force[i];
        for (int i = 0; i < nlu; ++i) s[l.u[i]] += force[nlx + i];
        for (int i = 0; i < l.nh; ++i)
            dense::axpy(nd, force[nlx + nlu + i], l.J.data() + (static_cast<std::size_t>(n) * l.nh + i) * px, w);
    }
    for (int i = 0; i < l.num_guards; ++i)
        dense::axpy(nd, l.force[N * l.rows + i], l.guard_J.data() + i * px, out.w.data() + m_offset[N - 1]);
}

// The Hessian of the rows at the end of step n, which the value function there takes up.
void Programme::add_limits_to_value(int n) {
    const Limits& l = limits_;
    const int px = padded(ndx_);
    double* P = stages_[n].P;
    for (std::size_t i = 0; i < l.x.size(); ++i) P[l.x[i] * px + l.x[i]] += l.sigma[n * l.rows + i];
    if (!l.has_matrix(n, N)) return;
    const double* B = l.B.data() + (l.nh ? static_cast<std::size_t>(n) * px * px : 0);
    for (int i = 0; i < ndx_ * px; ++i) P[i] += B[i];
}

// Hx += (that Hessian) dx, and likewise for the controls.
void Programme::add_limit_products(int n, const double* dx, const double* du, double* Hx, double* Hu) const {
    const Limits& l = limits_;
    const double* sigma = l.sigma.data() + n * l.rows;
    for (std::size_t i = 0; i < l.x.size(); ++i) Hx[l.x[i]] += sigma[i] * dx[l.x[i]];
    for (std::size_t i = 0; i < l.u.size(); ++i) Hu[l.u[i]] += sigma[l.x.size() + i] * du[l.u[i]];
    if (!l.has_matrix(n, N)) return;
    const int px = padded(ndx_);
    dense::gemv(ndx_, ndx_, l.B.data() + (l.nh ? static_cast<std::size_t>(n) * px * px : 0), px, dx, Hx);
}

// Slacks and multipliers along the direction, how far these allow to go, and the barrier's part of the slope.
void Programme::find_limit_step(Direction& d) {
    Limits& l = limits_;
    const int nd = ndx_, px = padded(nd), nlx = static_cast<int>(l.x.size()), nlu = static_cast<int>(l.u.size());
    for (int n = 0; n < N; ++n) {
        double* ds = l.ds.data() + n * l.rows;
        const double* dx = step_.dx.data() + static_cast<std::size_t>(n + 1) * nd;
        for (int i = 0; i < nlx; ++i) ds[i] = dx[l.x[i]];
        for (int i = 0; i < nlu; ++i) ds[nlx + i] = step_.du[u_offset[n] + l.u[i]];
        for (int i = 0; i < l.nh; ++i)
            ds[nlx + nlu + i] = dense::dot(nd, l.J.data() + (static_cast<std::size_t>(n) * l.nh + i) * px, dx);
    }
    for (int i = 0; i < l.num_guards; ++i)
        l.ds[N * l.rows + i] =
            dense::dot(nd, l.guard_J.data() + i * px, step_.dx.data() + static_cast<std::size_t>(N) * nd);
    const double mu = l.barrier, tau = std::max(1.0 - least_rest, 1.0 - mu);
    double approach = 0, decline = 0;  // largest relative loss of a distance, and of a multiplier
    for (int i = 0; i < l.total; ++i) {
        const double ds = l.ds[i] += l.defect[i];
        if (has(l.lower[i])) {
            const double inverse = 1.0 / (slack[i] - l.lower[i]);
            l.dz_lower[i] = (mu - z_lower[i] * ds) * inverse - z_lower[i];
            approach = std::max(approach, -ds * inverse), decline = std::max(decline, -l.dz_lower[i] / z_lower[i]);
            d.slope -= mu * inverse * ds;
        }
        if (has(l.upper[i])) {
            const double inverse = 1.0 / (l.upper[i] - slack[i]);
            l.dz_upper[i] = (mu + z_upper[i] * ds) * inverse - z_upper[i];
            approach = std::max(approach, ds * inverse), decline = std::max(decline, -l.dz_upper[i] / z_upper[i]);
            d.slope += mu * inverse * ds;
        }
    }
    d.longest = approach > tau ? tau / approach : 1.0;
    d.longest_dual = decline > tau ? tau / decline : 1.0;
}

// Barrier and defects of the moved iterate.
bool Programme::try_limits(Trial& t) {
    Limits& l = limits_;
    const int nlx = static_cast<int>(l.x.size()), nlu = static_cast<int>(l.u.size());
    bool ok = true;
    for (int n = 0; n < N; ++n) {
        double* h = l.h.data() + n * l.rows;
        const double* xn = x_trial_.data() + static_cast<std::size_t>(n + 1) * nx_;
        for (int i = 0; i < nlx; ++i) h[i] = xn[l.x[i]];
        for (int i = 0; i < nlu; ++i) h[nlx + i] = u_trial_[u_offset[n] + l.u[i]];
        if (l.nh) ok = evaluate_path(n, x_trial_, h + nlx + nlu, nullptr, nullptr) && ok;
    }
    if (l.num_guards) ok = evaluate_guard(x_trial_, l.h.data() + N * l.rows, nullptr, nullptr) && ok;
    Barrier barrier;
    for (int i = 0; i < l.total; ++i) {
        t.violation += std::abs(l.h[i] - l.slack_trial[i]);
        if (has(l.lower[i])) barrier.add(l.slack_trial[i] - l.lower[i]);
        if (has(l.upper[i])) barrier.add(l.upper[i] - l.slack_trial[i]);
    }
    t.objective += barrier.value(l.barrier);
    return ok && barrier.ok;
}

// In `accept`: slacks as moved, multipliers on their way, kept near the central path.
void Programme::accept_limits(double alpha) {
    Limits& l = limits_;
    slack.swap(l.slack_trial);
    for (int i = 0; i < l.total; ++i) {
        const auto moved = [&](double z, double dz, double distance) {
            const double centre = l.barrier / distance;
            return std::min(std::max(z + alpha * dz, centre / most_off_centre), centre * most_off_centre);
        };
        if (has(l.lower[i])) z_lower[i] = moved(z_lower[i], l.dz_lower[i], slack[i] - l.lower[i]);
        if (has(l.upper[i])) z_upper[i] = moved(z_upper[i], l.dz_upper[i], l.upper[i] - slack[i]);
    }
}

Numbers Programme::limit_multipliers() const {
    Numbers out(z_upper);
    for (std::size_t i = 0; i < out.size(); ++i) out[i] -= z_lower[i];
    return out;
}

}  // namespace mbocp
