#include "riccati.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <stdexcept>

namespace mbocp {
using dense::padded;

namespace {

constexpr int most_passes = 4;  // that the multipliers of equations are worth

}  // namespace

Riccati::Riccati(const Problem& problem, Data& data, Step& step, Barrier& barrier)
    : problem_(problem), data_(data), barrier_(barrier), eta_(problem),
      elimination_(make_elimination(problem, data, step, barrier, eta_)), check_(problem, data, step, barrier),
      rhs_(problem), direction_(problem), correction_(problem), ahead_(problem.N) {}

void Riccati::forget() {
    known_ = Known::nothing;
    elimination_->forget();
}

void Riccati::forget_residual() {
    known_ = Known::nothing;
    elimination_->forget_residual();
}

void Riccati::forget_right_hand_side() {
    if (known_ == Known::backward) known_ = Known::factors;
}

Factorisation Riccati::factorise(double shift, double augment) {
    Factorisation f;
    f.smallest_pivot = 1.0;
    weights_ = {shift, augment};
    known_ = Known::nothing;
    gather_right_hand_side();
    if (!elimination_->start(rhs_, f)) return f;
    const Stage& last = data_.last();
    const int nd = problem_.nd, ng = problem_.ng, px = padded(nd), pg = padded(ng);
    for (int i = 0; i < nd; ++i)
        for (int j = 0; j < nd; ++j)
            for (int g = 0; g < ng; ++g) last.P[i * px + j] += augment * last.S[i * pg + g] * last.S[j * pg + g];
    eta_.clear();
    elimination_->start_backward(rhs_, weights_, eta_rhs_);
    const bool may_share = problem_.crew().size() > 1 && elimination_->may_share();
    const bool is_shared = may_share && section_.begin(), is_regular = is_shared ? condense_together(f) : condense(f);
    if (may_share) section_.end();
    if (!is_regular) return f;
    f.bad_stage = problem_.N;
    if (!eta_.factorise(f)) return f;
    known_ = Known::backward;
    f.bad_stage = -1, f.ok = true;
    return f;
}

bool Riccati::condense(Factorisation& f) {
    for (int n = problem_.N - 1; n >= 0; --n) {
        f.bad_stage = n;
        if (!elimination_->condense(n, weights_, f)) return false;
        // A right-hand side at hand costs little while the blocks are in the cache.
        elimination_->backward(n, rhs_, weights_, eta_rhs_);
    }
    return true;
}

// The recursion alone is one thread's; what comes before and after it at each stage is done beside it.
bool Riccati::condense_together(Factorisation& f) {
    const int N = problem_.N;
    const auto backward = [&](int k) { elimination_->backward(N - 1 - k, rhs_, weights_, eta_rhs_); };
    bool is_regular = true;
    ahead_.start(), behind_.start();
    problem_.crew().together([&](int thread) {
        const auto prepare = [&](int k) { elimination_->condense_ahead(N - 1 - k, thread); };
        if (thread > 0) {
            ahead_.help(prepare);
            if (thread == 1) behind_.help(backward);
            return;
        }
        for (int k = 0; k < N && is_regular; ++k) {
            ahead_.need(k, prepare);
            f.bad_stage = N - 1 - k;
            is_regular = elimination_->condense(N - 1 - k, weights_, f);
            if (is_regular) behind_.allow(k + 1);
        }
        behind_.finish(is_regular ? N : 0, backward);
    });
    return is_regular;
}

void Riccati::gather_residual() {
    for (int n = 0; n < problem_.N; ++n) {
        const Stage& s = data_[n];
        const Kind& k = *s.kind;
        std::copy(s.c, s.c + k.nc(), rhs_.c.begin() + problem_.m_offset[n]);
        std::copy(s.gw, s.gw + k.nw(), rhs_.w.begin() + problem_.m_offset[n]);
        std::copy(s.gs, s.gs + k.ns(), rhs_.s.data() + problem_.s_offset(n));
    }
    rhs_.x_terminal = data_.end.r_x;
    rhs_.g = data_.end.g;
}

void Riccati::gather_right_hand_side() {
    gather_residual();
    if (barrier_.empty()) return;
    barrier_.start_equations();
    barrier_.add_gradients(rhs_);
}

void Riccati::backward(const Residual& rhs) {
    elimination_->prepare(rhs);
    elimination_->start_backward(rhs, weights_, eta_rhs_);
    for (int n = problem_.N - 1; n >= 0; --n) elimination_->backward(n, rhs, weights_, eta_rhs_);
}

void Riccati::start_forward(Increment& out) {
    eta_.solve(eta_rhs_, out.deta);
    std::fill(out.dx.begin(), out.dx.begin() + problem_.ndx, 0.0);
}

void Riccati::forward(const Residual& rhs, Increment& out, KktCheck* check) {
    start_forward(out);
    elimination_->forward(rhs, weights_, out, check);
}

Direction Riccati::solve(int refinements) {
    if (known_ == Known::nothing) throw std::logic_error("solve: the last factorisation failed or is missing");
    if (known_ != Known::backward) gather_right_hand_side();
    return finish(refinements);
}

Direction Riccati::solve_motion() {
    if (known_ == Known::nothing) throw std::logic_error("solve_motion: the last factorisation failed or is missing");
    if (known_ != Known::backward) gather_right_hand_side(), backward(rhs_);
    known_ = Known::factors;
    start_forward(direction_);
    elimination_->forward_motion(direction_);
    Direction d;
    double squared = 0;
    for (const Numbers* part : {&direction_.dx, &direction_.du})
        squared += dense::dot(static_cast<int>(part->size()), part->data(), part->data());
    if (!barrier_.empty()) barrier_.find_step(direction_, d);
    d.finite = std::isfinite(squared);
    return d;
}

Direction Riccati::correct(double alpha, const Numbers& c, const Numbers& g) {
    if (known_ == Known::nothing) throw std::logic_error("correct: the last factorisation failed or is missing");
    known_ = Known::factors;
    gather_residual();
    if (!barrier_.empty()) {
        barrier_.correct_equations(alpha);
        barrier_.add_gradients(rhs_);
    }
    for (std::size_t i = 0; i < rhs_.c.size(); ++i) rhs_.c[i] = alpha * rhs_.c[i] + c[i];
    for (std::size_t i = 0; i < rhs_.g.size(); ++i) rhs_.g[i] = alpha * rhs_.g[i] + g[i];
    return finish(0);
}

double Riccati::solve_for(const Residual& rhs, const Numbers& equations) {
    if (known_ == Known::nothing) throw std::logic_error("solve_for: the last factorisation failed or is missing");
    known_ = Known::factors;
    const auto negative = [](const Numbers& from, Numbers& to) {
        std::transform(from.begin(), from.end(), to.begin(), std::negate<>());
    };
    negative(rhs.c, rhs_.c), negative(rhs.w, rhs_.w), negative(rhs.s, rhs_.s);
    negative(rhs.x_terminal, rhs_.x_terminal), negative(rhs.g, rhs_.g);
    if (!barrier_.empty()) {
        barrier_.start_equations(equations);
        barrier_.add_gradients(rhs_);
    }
    const double left = refine(most_passes, Barrier::Accuracy::full()).linear_residual;
    return std::max(left, barrier_.missed(direction_));
}

const Increment& Riccati::correction_for(const Residual& left) {
    backward(left);
    forward(left, correction_, nullptr);
    return correction_;
}

Direction Riccati::finish(int refinements) {
    Direction d = refine(refinements, Barrier::Accuracy::of_newton());
    measure(d);
    if (!barrier_.empty()) barrier_.find_step(direction_, d);
    d.finite = std::isfinite(d.increment) && std::isfinite(d.linear_residual);
    return d;
}

// The direction for rhs_, refined where its residual is not at round-off.
Direction Riccati::refine(int refinements, const Barrier::Accuracy& accuracy) {
    Direction d;
    if (known_ != Known::backward) backward(rhs_);
    known_ = Known::factors;
    check_.start();
    forward(rhs_, direction_, &check_);
    double scale = 0;
    for (const Numbers* part : {&rhs_.c, &rhs_.w, &rhs_.s, &rhs_.g})
        scale = std::max(scale, dense::largest(static_cast<int>(part->size()), part->data()));
    bool is_last = false;
    for (int pass = 0;; ++pass) {
        d.linear_residual = scale > 0 ? check_.largest / scale : check_.largest, d.curvature = check_.curvature;
        const bool is_exact = pass >= refinements || !(check_.largest > 1e-11 * scale);
        if (is_last || (is_exact && !barrier_.has_equations())) break;
        if (barrier_.has_equations()) {
            const Barrier::Passes passes = barrier_.resolve_equations(direction_, accuracy);
            if (is_exact && passes == Barrier::Passes::enough) break;
            if (passes == Barrier::Passes::more && pass >= most_passes) break;
            is_last = passes == Barrier::Passes::repeat;
            if (is_last) barrier_.take_back(pass + 1);
            barrier_.add_pass(rhs_), barrier_.add_pass(check_.left);
        }
        backward(check_.left);
        forward(check_.left, correction_, nullptr);
        direction_.add(correction_);
        check_.start();
        for (int n = 0; n < problem_.N; ++n) check_.add_stage(n, rhs_, direction_, weights_.shift);
        check_.add_end(rhs_, direction_);
    }
    return d;
}

// Its norm in the reported scaling, and the slope of the cost along it.
void Riccati::measure(Direction& d) const {
    const int nd = problem_.ndx;
    double squared = 0;
    for (int n = 0; n < problem_.N; ++n) {
        const Stage& s = data_[n];
        const Kind& k = *s.kind;
        const double *dx0 = direction_.dx.data() + problem_.dx_offset(n), *dx1 = dx0 + nd;
        squared += dense::dot(nd, dx1, dx1);
        d.turn = std::max(d.turn, dense::weighted_largest(static_cast<int>(k.turning.size()), dx1, k.turning.data()));
        d.slope += dense::dot(nd, s.lw, dx1) + dense::dot(nd, s.ls, dx0);
        const double *dy = direction_.dy.data() + problem_.y_offset[n],
                     *du = direction_.du.data() + problem_.u_offset[n];
        const double* dm = direction_.dm.data() + problem_.m_offset[n];
        squared += dense::weighted_squares(k.ny, dy, k.scale_y.data()) + dense::dot(k.nu, du, du) +
                   dense::weighted_squares(k.nc(), dm, k.scale_m.data());
        d.slope += dense::dot(k.ny, s.lw + nd, dy) + dense::dot(k.nu, s.ls + nd, du);
    }
    const double* dx_end = direction_.dx.data() + problem_.dx_offset(problem_.N);
    for (int i = 0; i < nd; ++i) d.slope += data_.end.psi_x[i] * dx_end[i];
    for (const double v : direction_.deta) squared += v * v;
    d.increment = std::sqrt(squared);
}

}  // namespace mbocp
