#include "programme.hpp"

#include <map>
#include <stdexcept>

namespace mbocp {
using dense::padded;

namespace {

void check_output(const Function& f, std::size_t index, int rows, int columns, const char* what) {
    if (f->outputs.size() <= index || f->outputs[index].rows != rows || f->outputs[index].columns != columns)
        throw std::invalid_argument(std::string(what) + ": expected output " + std::to_string(index) + " of shape (" +
                                    std::to_string(rows) + ", " + std::to_string(columns) + ")");
}

double square(double v) { return v * v; }

}  // namespace

// Whether Jw has entries on its diagonal alone, as where the step's rows are F(x_before, u) - x.
static bool has_diagonal(const Pattern& J, int nw) {
    int count = 0;
    for (int k = 0; k < J.nnz(); ++k) {
        if (J.column[k] >= nw) continue;
        if (J.row[k] != J.column[k]) return false;
        ++count;
    }
    return count == nw;
}

void Kind::prepare() {
    check_output(values, 0, nc(), 1, "values");
    check_output(jacobian, 2, nc(), nw() + ns(), "jacobian");
    check_output(complete, 2, nc(), nw() + ns(), "complete");
    check_output(complete, 4, nw() + ns(), nw() + ns(), "complete");
    if (!groups.empty()) prepare_structure();
    may_be_explicit =
        groups.empty() && has_diagonal(complete->outputs[2], nw()) && has_diagonal(jacobian->outputs[2], nw());
    const int ldw = padded(nw()), lds = padded(ns());
    const auto split = [&](int j) { return j < nw(); };
    const auto derivatives = [&](const StageFunction& f, std::vector<Target>& jacobian_targets,
                                 std::vector<Target>& gradient_targets) {
        jacobian_targets.clear(), gradient_targets.clear();
        const Pattern& J = f.outputs[2];
        for (int k = 0; k < J.nnz(); ++k) {
            const int i = J.row[k], j = J.column[k];
            jacobian_targets.push_back(split(j) ? Target{JW, i * ldw + j, -1} : Target{JS, i * lds + j - nw(), -1});
        }
        const Pattern& g = f.outputs[3];
        for (int k = 0; k < g.nnz(); ++k) {
            const int i = std::max(g.row[k], g.column[k]);
            gradient_targets.push_back(split(i) ? Target{GW, i, -1} : Target{GS, i - nw(), -1});
        }
    };
    derivatives(*complete, to_jacobian, to_gradient);
    derivatives(*jacobian, to_first_jacobian, to_first_gradient);
    to_hessian.clear();
    const Pattern& H = complete->outputs[4];
    for (int k = 0; k < H.nnz(); ++k) {
        const int i = H.row[k], j = H.column[k];  // upper: i <= j
        if (split(j))
            to_hessian.push_back({HWW, i * ldw + j, j * ldw + i});
        else if (split(i))
            to_hessian.push_back({HWS, i * lds + j - nw(), -1});
        else
            to_hessian.push_back({HSS, (i - nw()) * lds + j - nw(), (j - nw()) * lds + i - nw()});
    }
}

void Kind::prepare_structure() {
    const Pattern &all = complete->outputs[2], &first = jacobian->outputs[2];
    structure = std::make_shared<Structure>(all, ndx, ny, nu, groups);
    hessian = SymmetricRows(complete->outputs[4]);
    const int nq = structure->nq, nr = structure->nr, before = nw(), controls = nw() + ndx;
    const Pattern& upper = complete->outputs[4];
    const auto is_y = [&](int i) { return i >= ndx && i < before; };
    for (int k = 0; k < upper.nnz(); ++k)
        if (is_y(upper.row[k]) || (is_y(upper.column[k]) && upper.row[k] >= nq))
            throw std::invalid_argument("groups: the Hessian couples algebraic unknowns with more than q");
    const auto over_state = [&](int row, int rows, int at) {
        return OverState{hessian.block(row, rows, at, nq), hessian.block(row, rows, at + nq, nq),
                         hessian.block(row, rows, at + 2 * nq, nr)};
    };
    of_x = over_state(0, ndx, 0), of_before_in_x = over_state(before, ndx, 0),
    of_before = over_state(before, ndx, before);
    of_u_in_x = over_state(controls, nu, 0), of_u_in_before = over_state(controls, nu, before);
    of_u = hessian.block(controls, nu, controls, nu), of_y_in_q = hessian.block(ndx, ny, 0, nq);
    std::map<std::pair<int, int>, int> place;
    for (int k = 0; k < all.nnz(); ++k) place[{all.row[k], all.column[k]}] = k;
    for (int k = 0; k < first.nnz(); ++k) {
        const auto found = place.find({first.row[k], first.column[k]});
        if (found == place.end()) throw std::invalid_argument("jacobian: a nonzero that complete does not have");
        first_place.push_back(found->second);
    }
}

Programme::Programme(std::vector<Kind> kinds, std::vector<int> stage_kind, Terminal terminal, Function retract,
                     Function difference)
    : kinds_(std::move(kinds)), stage_kind_(std::move(stage_kind)), terminal_(std::move(terminal)),
      retract_(std::move(retract)), difference_(std::move(difference)), N(static_cast<int>(stage_kind_.size())) {
    if (N < 1 || kinds_.empty()) throw std::invalid_argument("a programme needs at least one stage and one kind");
    nx_ = kinds_[0].nx, ndx_ = kinds_[0].ndx, ng_ = terminal_.ng;
    for (auto& kind : kinds_) {
        if (kind.nx != nx_ || kind.ndx != ndx_) throw std::invalid_argument("kinds differ in the size of the state");
        kind.prepare();
    }
    is_structured_ = kinds_[0].structure != nullptr;
    nd_ = is_structured_ ? 2 * kinds_[0].structure->d + kinds_[0].structure->nr : ndx_;
    for (const auto& kind : kinds_)
        if ((kind.structure != nullptr) != is_structured_ || (is_structured_ && kind.ny != kinds_[0].ny))
            throw std::invalid_argument("kinds differ in their structure");
    check_output(terminal_.values, 1, ng_, 1, "terminal values");
    check_output(terminal_.complete, 2, ng_, ndx_, "terminal complete");
    check_output(retract_, 0, nx_, 1, "retract");
    check_output(difference_, 0, ndx_, 1, "difference");
    allocate();
}

// Workspace of a stage's reduction beside its structure's.
std::size_t Programme::reduced_space(const Kind& k) const {
    const Structure& t = *k.structure;
    const std::size_t px = padded(nd_), pm = padded(nd_ + k.nu), pd = padded(t.d), pu = padded(k.nu);
    const std::size_t hessian = t.nq * (pm + pd) + pd * (pm + pd) + (ndx_ + pu + 2 * px) * px + px * pm + t.ny * pd;
    return std::max({hessian, (px + pu) * px + (px + pm) * pm + pm * padded(ng_), 2 * ndx_ * px + ndx_ + px});
}

void Programme::allocate() {
    std::size_t total = 0, pivots = 0, space = 0;
    int ny = 0, nu = 0, nm = 0, nr = 0;
    y_offset = u_offset = m_offset = r_offset = {0};
    const int ldx = padded(ndx_), ldg = padded(ng_), ldd = padded(nd_);
    // Each stage's blocks, in the order in which the factorisation walks through them.
    const auto lay_out = [&](const Kind& k, double* base, Stage* stage, int* ints) {
        std::size_t at = 0;
        const auto take = [&](double*& target, std::size_t size) {
            if (base) target = base + at;
            at += (size + 3) / 4 * 4;
        };
        Stage unused{};
        Stage& s = stage ? *stage : unused;
        double* step = nullptr;
        const std::size_t nw = k.nw(), pw = padded(k.nw()), ps = padded(k.ns()), nc = k.nc();
        take(s.c, nc), take(s.gw, nw), take(s.gs, k.ns()), take(s.lw, nw), take(s.ls, k.ns());
        if (k.structure) {
            take(s.J, k.complete->outputs[2].nnz()), take(s.H, k.complete->outputs[4].nnz());
            const std::size_t pm = padded(nd_ + k.nu);
            take(step, k.structure->num_doubles()), take(s.T, nd_ * pm), take(s.Q, pm * pm), take(s.g, ldd + pm);
            take(s.b, ndx_), take(s.Hz, nw + k.ns());
        } else {
            take(s.Jw, nc * pw), take(s.Js, nc * ps);
            take(s.Hww, pw * pw), take(s.Hws, pw * ps), take(s.Hss, ps * ps);
            take(s.LU, nc * pw), take(s.T, pw * ps);
        }
        take(s.Quu, static_cast<std::size_t>(k.nu) * padded(k.nu));
        take(s.K, static_cast<std::size_t>(padded(k.nu)) * ldd), take(s.Keta, static_cast<std::size_t>(k.nu) * ldg);
        take(s.P, static_cast<std::size_t>(ldd) * ldd), take(s.S, static_cast<std::size_t>(ldd) * ldg);
        take(s.t0, nw), take(s.k, k.nu), take(s.p, nd_);
        if (k.structure && base) k.structure->place(s.step, step, ints);
        return at;
    };
    const auto num_pivots = [&](const Kind& k) {
        return k.nu + (k.structure ? nd_ + static_cast<int>(k.structure->num_ints()) : k.nc());
    };
    for (const int index : stage_kind_) {
        const Kind& k = kinds_.at(static_cast<std::size_t>(index));
        total += lay_out(k, nullptr, nullptr, nullptr);
        pivots += static_cast<std::size_t>(num_pivots(k));
        y_offset.push_back(ny += k.ny), u_offset.push_back(nu += k.nu);
        m_offset.push_back(nm += k.nc()), r_offset.push_back(nr += k.nr);
    }
    pivots_.assign(pivots, 0);
    stages_.resize(static_cast<std::size_t>(N));
    double* base = pool_.allocate(total + 8);
    int* pivot = pivots_.data();
    std::size_t largest = 0;
    for (int n = 0; n < N; ++n) {
        const Kind& k = kinds_[static_cast<std::size_t>(stage_kind_[n])];
        Stage& s = stages_[n];
        s = Stage{};
        s.kind = &k, s.pivot = pivot, s.definite = true, s.chosen = pivot + k.nu;
        s.control_pivot = pivot + (k.structure ? 0 : k.nc());
        base += lay_out(k, base, &s, pivot + k.nu + nd_);
        pivot += num_pivots(k);
        const std::size_t pw = padded(k.nw()), ps = padded(k.ns());
        max_nw_ = std::max(max_nw_, k.nw()), max_ns_ = std::max(max_ns_, k.ns());
        diagonal_.resize(std::max(diagonal_.size(), static_cast<std::size_t>(k.nu)));
        if (k.structure) {
            largest = std::max(largest, 12 * (pw + ps) + static_cast<std::size_t>(ldx) * (2 * ldx + 4));
            space = std::max(space, reduced_space(k) + k.structure->work_size());
        } else {
            largest = std::max(largest, pw * pw + 2 * pw * ps + ps * ps + 8 * (pw + ps) + (ps + 4) * (ldx + ldg));
        }
    }
    space_.allocate(space + 256),
        both_.assign(is_structured_ ? 2 * static_cast<std::size_t>(max_nw_ + max_ns_) : 0, 0.0);
    x.assign(static_cast<std::size_t>(N + 1) * nx_, 0.0);
    y.assign(ny, 0.0), u.assign(nu, 0.0), m.assign(nm, 0.0), eta.assign(ng_, 0.0);
    rho_.assign(nr, 0.0);
    Hterm_.assign(static_cast<std::size_t>(ldx) * ldx, 0.0);
    Sterm_.assign(static_cast<std::size_t>(ndx_) * ldg, 0.0);
    gterm_.assign(ng_, 0.0), psix_.assign(ndx_, 0.0), rterm_.assign(ndx_, 0.0);
    R_.assign(static_cast<std::size_t>(padded(ng_)) * ldg + 4, 0.0);
    const auto size_step = [&](Step& d) {
        d.dx.assign(static_cast<std::size_t>(N + 1) * ndx_, 0.0);
        d.dy.assign(ny, 0.0), d.du.assign(nu, 0.0), d.dm.assign(nm, 0.0), d.deta.assign(ng_, 0.0);
    };
    size_step(step_), size_step(correction_);
    const auto size_residual = [&](Residual& r) {
        r.c.assign(nm, 0.0), r.w.assign(nm, 0.0);
        r.s.assign(static_cast<std::size_t>(nu) + static_cast<std::size_t>(N) * ndx_, 0.0);
        r.x_terminal.assign(ndx_, 0.0), r.g.assign(ng_, 0.0);
    };
    size_residual(rhs_), size_residual(work_);
    x_trial_ = x, y_trial_ = y, u_trial_ = u, zeros_.assign(static_cast<std::size_t>(max_nw_ + max_ns_), 0.0);
    c_trial_.assign(nm, 0.0), g_trial_.assign(ng_, 0.0);
    scratch_.allocate(largest + 256);
    scaled_m_.assign(nm, 0.0);
    sweep_c_.assign(3 * static_cast<std::size_t>(max_nw_), 0.0);
    sweep_dx_.assign(ndx_, 0.0), planned_.assign(2 * static_cast<std::size_t>(nx_), 0.0),
        sweep_before_.assign(static_cast<std::size_t>(nx_) + max_nw_, 0.0);
}

void Programme::set_parameters(const Numbers& theta, const Numbers& rho, const Numbers& rho_terminal) {
    if (static_cast<int>(rho.size()) != r_offset.back()) throw std::invalid_argument("stage parameters: wrong length");
    theta_ = theta, rho_ = rho, rho_terminal_ = rho_terminal;
    theta_.resize(theta_.size() + 1), rho_.resize(rho_.size() + 1), rho_terminal_.resize(rho_terminal_.size() + 1);
}

void Programme::bind(StageFunction& f, int n, const Numbers& x_now, const Numbers& y_now, const Numbers& u_now) const {
    f.arg[0] = x_now.data() + static_cast<std::size_t>(n) * nx_;
    f.arg[1] = f.arg[0] + nx_;
    f.arg[2] = y_now.data() + y_offset[n];
    f.arg[3] = u_now.data() + u_offset[n];
}

namespace {

// Adds a row to the violation (l1, the programme's scaling) and to the squared primal norm (the reported scaling).
struct Violations {
    Evaluation& e;
    double squared = 0;

    void add(double value, double scale, int stage, int row) {
        e.violation += std::abs(value);
        squared += square(value * scale);
        if (!(std::abs(value * scale) <= e.worst))
            e.worst = std::abs(value * scale), e.worst_stage = stage, e.worst_row = row;
    }
};

}  // namespace

bool Programme::evaluate_stage(int n, const double* multipliers, Evaluation& e) {
    Stage& s = stages_[n];
    const Kind& k = *s.kind;
    StageFunction& f = *k.complete;
    bind(f, n, x, y, u);
    f.arg[4] = multipliers + m_offset[n];
    f.arg[5] = theta_.data();
    f.arg[6] = rho_.data() + r_offset[n];
    if (k.structure) f.res[2] = s.J, f.res[4] = s.H;
    const bool ok = f.call();
    e.cost += f.outputs[1].nnz() ? f.res[1][0] : 0.0;
    double* blocks[] = {s.Jw, s.Js, s.Hww, s.Hws, s.Hss, s.lw, s.ls};
    const Pattern& c = f.outputs[0];
    for (int i = 0; i < c.nnz(); ++i) s.c[c.row[i]] = f.res[0][i];
    for (std::size_t i = 0; i < k.to_gradient.size(); ++i)
        blocks[k.to_gradient[i].block][k.to_gradient[i].offset] = f.res[3][i];
    if (k.structure) {
        k.hessian.halve_diagonal(s.H);
    } else {
        for (std::size_t i = 0; i < k.to_jacobian.size(); ++i)
            blocks[k.to_jacobian[i].block][k.to_jacobian[i].offset] = f.res[2][i];
        for (std::size_t i = 0; i < k.to_hessian.size(); ++i) {
            const auto& t = k.to_hessian[i];
            blocks[t.block][t.offset] = f.res[4][i];
            if (t.mirror >= 0) blocks[t.block][t.mirror] = f.res[4][i];
        }
    }
    dense::copy(s.lw, s.gw, k.nw());
    dense::copy(s.ls, s.gs, k.ns());
    add_jacobian_transposed(n, m.data() + m_offset[n], s.gw, s.gs);
    return ok;
}

bool Programme::evaluate_terminal(Evaluation& e) {
    StageFunction& t = *terminal_.complete;
    t.arg[0] = x.data() + static_cast<std::size_t>(N) * nx_;
    t.arg[1] = eta.data();
    t.arg[2] = rho_terminal_.data();
    const bool ok = t.call();
    e.cost += t.outputs[0].nnz() ? t.res[0][0] : 0.0;
    for (int i = 0; i < t.outputs[1].nnz(); ++i) gterm_[t.outputs[1].row[i]] = t.res[1][i];
    for (int i = 0; i < t.outputs[2].nnz(); ++i)
        Sterm_[t.outputs[2].column[i] * padded(ng_) + t.outputs[2].row[i]] = t.res[2][i];
    for (int i = 0; i < t.outputs[3].nnz(); ++i)
        psix_[std::max(t.outputs[3].row[i], t.outputs[3].column[i])] = t.res[3][i];
    for (int i = 0; i < t.outputs[4].nnz(); ++i) {
        const int a = t.outputs[4].row[i], b = t.outputs[4].column[i];
        Hterm_[a * padded(ndx_) + b] = Hterm_[b * padded(ndx_) + a] = t.res[4][i];
    }
    dense::copy(psix_.data(), rterm_.data(), ndx_);
    dense::gemv(ndx_, ng_, Sterm_.data(), padded(ng_), eta.data(), rterm_.data());
    return ok;
}

// Squared norm of the stationarity conditions, and their largest defect before it is scaled; that in x_n collects from
// stage n and from stage n + 1.
double Programme::stationarity(double& largest) const {
    double sum = 0;
    for (int n = 0; n < N; ++n) {
        const Stage& s = stages_[n];
        const Kind& k = *s.kind;
        const double* after = n + 1 < N ? stages_[n + 1].gs : rterm_.data();
        const double* of_x = limits_.empty() ? zeros_.data() : limits_.of_x.data() + static_cast<std::size_t>(n) * ndx_;
        const double* of_u = limits_.empty() ? zeros_.data() : limits_.of_u.data() + u_offset[n];
        const auto add = [&](double defect, double scale) {
            largest = std::max(largest, std::abs(defect)), sum += square(defect * scale);
        };
        for (int i = 0; i < ndx_; ++i) add(s.gw[i] + after[i] + of_x[i], 1.0);
        for (int i = 0; i < k.ny; ++i) add(s.gw[ndx_ + i], 1.0);
        for (int i = 0; i < k.nu; ++i) add(s.gs[ndx_ + i] + of_u[i], k.scale_ru[i]);
    }
    return sum;
}

Evaluation Programme::evaluate(double share) {
    Evaluation e;
    backward_done_ = steps_known_ = residual_known_ = false;
    const double* multipliers = m.data();
    if (share != 1.0) {
        for (std::size_t i = 0; i < m.size(); ++i) scaled_m_[i] = share * m[i];
        multipliers = scaled_m_.data();
    }
    bool ok = true;
    Violations violations{e};
    for (int n = 0; n < N; ++n) {
        ok = evaluate_stage(n, multipliers, e) && ok;
        const Kind& k = *stages_[n].kind;
        for (int i = 0; i < k.nc(); ++i) violations.add(stages_[n].c[i], k.scale_c[i], n, i);
    }
    ok = evaluate_terminal(e) && ok;
    for (int i = 0; i < ng_; ++i) violations.add(gterm_[i], 1.0, -1, i);
    const Limits& l = limits_;
    if (!l.empty()) {
        ok = evaluate_limits() && ok;
        for (int i = 0; i < l.total; ++i) {
            const bool is_guard = i >= N * l.rows;
            const int n = is_guard ? -1 : i / l.rows;
            violations.add(l.defect[i], 1.0, n, is_guard ? ng_ + i - N * l.rows : stages_[n].kind->nc() + i % l.rows);
        }
    }
    const double dual = stationarity(e.barrier_error);
    e.primal = std::sqrt(violations.squared), e.dual = std::sqrt(dual);
    e.residual = std::sqrt(violations.squared + dual), e.objective = e.cost;
    e.barrier_error = std::max(e.barrier_error, e.worst);
    e.finite = ok && std::isfinite(e.residual) && std::isfinite(e.cost);
    last_ = e;
    return l.empty() ? e : weigh(l.barrier);
}

bool Programme::retract_into(const double* x_now, const double* dx, double alpha, double* x_next) {
    double* scaled = scratch_.data();
    for (int i = 0; i < ndx_; ++i) scaled[i] = alpha * dx[i];
    retract_->arg[0] = x_now;
    retract_->arg[1] = scaled;
    if (!retract_->call()) return false;
    for (int i = 0; i < retract_->outputs[0].nnz(); ++i) x_next[retract_->outputs[0].row[i]] = retract_->res[0][i];
    return true;
}

bool Programme::move(double alpha) {
    bool ok = true;
    for (std::size_t i = 0; i < y.size(); ++i) y_trial_[i] = y[i] + alpha * step_.dy[i];
    for (std::size_t i = 0; i < u.size(); ++i) u_trial_[i] = u[i] + alpha * step_.du[i];
    std::copy(x.begin(), x.begin() + nx_, x_trial_.begin());
    for (int n = 1; n <= N; ++n)
        ok = retract_into(x.data() + static_cast<std::size_t>(n) * nx_,
                          step_.dx.data() + static_cast<std::size_t>(n) * ndx_, alpha,
                          x_trial_.data() + static_cast<std::size_t>(n) * nx_) &&
             ok;
    for (int i = 0; i < limits_.total; ++i) limits_.slack_trial[i] = slack[i] + alpha * limits_.ds[i];
    return ok;
}

Trial Programme::trial(double alpha) {
    Trial t;
    bool ok = move(alpha);
    for (int n = 0; n < N; ++n) {
        const Kind& k = *stages_[n].kind;
        StageFunction& f = *k.values;
        bind(f, n, x_trial_, y_trial_, u_trial_);
        f.arg[4] = theta_.data();
        f.arg[5] = rho_.data() + r_offset[n];
        ok = f.call() && ok;
        double* c = c_trial_.data() + m_offset[n];
        for (int i = 0; i < f.outputs[0].nnz(); ++i) c[f.outputs[0].row[i]] = f.res[0][i];
        for (int i = 0; i < k.nc(); ++i) t.violation += std::abs(c[i]);
        t.objective += f.outputs[1].nnz() ? f.res[1][0] : 0.0;
    }
    StageFunction& f = *terminal_.values;
    f.arg[0] = x_trial_.data() + static_cast<std::size_t>(N) * nx_;
    f.arg[1] = rho_terminal_.data();
    ok = f.call() && ok;
    t.objective += f.outputs[0].nnz() ? f.res[0][0] : 0.0;
    for (int i = 0; i < f.outputs[1].nnz(); ++i) g_trial_[f.outputs[1].row[i]] = f.res[1][i];
    for (int i = 0; i < ng_; ++i) t.violation += std::abs(g_trial_[i]);
    if (!limits_.empty()) ok = try_limits(t) && ok;
    t.finite = ok && std::isfinite(t.objective) && std::isfinite(t.violation);
    return t;
}

void Programme::accept(double alpha, double alpha_limits) {
    x.swap(x_trial_), y.swap(y_trial_), u.swap(u_trial_);
    for (std::size_t i = 0; i < m.size(); ++i) m[i] += alpha * step_.dm[i];
    for (std::size_t i = 0; i < eta.size(); ++i) eta[i] += alpha * step_.deta[i];
    accept_limits(alpha_limits);
}

}  // namespace mbocp
