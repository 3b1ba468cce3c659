#include "limits.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

#include "dense.hpp"

namespace mbocp {
using dense::padded;

namespace {

std::vector<int> limited(const Numbers& lower, const Numbers& upper, int size, const std::string& name) {
    if (static_cast<int>(lower.size()) != size || lower.size() != upper.size())
        throw std::invalid_argument("limits of " + name + ": wrong length");
    std::vector<int> found;
    for (int i = 0; i < size; ++i) {
        if (!std::isfinite(lower[i]) && !std::isfinite(upper[i])) continue;
        if (!(lower[i] < upper[i])) throw std::invalid_argument("limits of " + name + ": no room");
        found.push_back(i);
    }
    return found;
}

// Calls a function (..., m, ...) -> h, dh_dx, upper Hessian of m'h; values into h, and, where J and H are not null,
// derivatives into J and added to H, both with leading dimension px.
bool call_rows(StageFunction& f, int px, double* h, double* J, double* H) {
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

void Limits::set(const Bounds& bounds, Function path, Function guard) {
    const int N = problem_.N, nx = problem_.nx, nu = problem_.kinds()[0].nu;
    if (nx != problem_.ndx) throw std::invalid_argument("limits: states must be plain vectors");
    for (const auto& kind : problem_.kinds())
        if (kind.nu != nu) throw std::invalid_argument("limits: kinds differ in the number of controls");
    std::vector<int> x = limited(bounds.x_lower, bounds.x_upper, nx, "states");
    std::vector<int> u = limited(bounds.u_lower, bounds.u_upper, nu, "controls");
    const int nh = static_cast<int>(bounds.path_lower.size()), num_guards = bounds.num_guards;
    if (nh && !path) throw std::invalid_argument("limits: the path functions are missing");
    if (num_guards && !guard) throw std::invalid_argument("limits: the guards are missing");
    if (problem_.is_structured() && (nh || num_guards || !x.empty()))
        throw std::invalid_argument("limits: where stages have a structure, only controls can have any");
    x_ = std::move(x), u_ = std::move(u), nh_ = nh, num_guards_ = num_guards;
    path_ = std::move(path), guard_ = std::move(guard);

    Numbers low, high;
    for (const int i : x_) low.push_back(bounds.x_lower[i]), high.push_back(bounds.x_upper[i]);
    for (const int i : u_) low.push_back(bounds.u_lower[i]), high.push_back(bounds.u_upper[i]);
    low.insert(low.end(), bounds.path_lower.begin(), bounds.path_lower.end());
    high.insert(high.end(), bounds.path_upper.begin(), bounds.path_upper.end());
    rows_ = static_cast<int>(low.size());
    lower.clear(), upper.clear();
    for (int n = 0; n < N; ++n) {
        lower.insert(lower.end(), low.begin(), low.end());
        upper.insert(upper.end(), high.begin(), high.end());
    }
    lower.insert(lower.end(), num_guards, 0.0);
    upper.insert(upper.end(), num_guards, std::numeric_limits<double>::infinity());

    const std::size_t px = padded(problem_.ndx), nodes = nh_ ? N : num_guards_ ? 1 : 0;
    lambda_.assign(std::max(nh_, num_guards_), 0.0);
    gradient_x_.assign(problem_.dx_offset(N), 0.0), gradient_u_.assign(problem_.u_offset[N], 0.0);
    J_.assign(static_cast<std::size_t>(nh_) * N * px, 0.0), guard_J_.assign(num_guards_ * px, 0.0);
    H_.assign(nodes * px * px, 0.0), B_ = H_;
}

const double* Limits::jacobian(int n) const {
    return J_.data() + static_cast<std::size_t>(n) * nh_ * padded(problem_.ndx);
}

// Of H and B; without path functions there is one for the guards alone.
std::size_t Limits::matrix_offset(int n) const {
    const std::size_t px = padded(problem_.ndx);
    return nh_ ? static_cast<std::size_t>(n) * px * px : 0;
}

const double* Limits::matrix(int n) const {
    return nh_ > 0 || (num_guards_ > 0 && n == problem_.N - 1) ? B_.data() + matrix_offset(n) : nullptr;
}

bool Limits::call_path(int n, const Point& at, double* h, double* J, double* H) {
    path_->arg[0] = at.x.data() + problem_.x_offset(n + 1);
    path_->arg[1] = lambda_.data();
    path_->arg[2] = nullptr;  // zeros: what of a velocity a control prescribes is not limited
    path_->arg[3] = problem_.theta.data();
    return call_rows(*path_, padded(problem_.ndx), h, J, H);
}

bool Limits::call_guard(const Point& at, double* h, double* J, double* H) {
    guard_->arg[0] = at.x.data() + problem_.x_offset(problem_.N);
    guard_->arg[1] = lambda_.data();
    guard_->arg[2] = problem_.rho_terminal.data();
    return call_rows(*guard_, padded(problem_.ndx), h, J, H);
}

// Of limited states and controls.
void Limits::copy_values(int n, const Point& at, double* h) const {
    const double *x = at.x.data() + problem_.x_offset(n + 1), *u = at.u.data() + problem_.u_offset[n];
    for (const int i : x_) *h++ = x[i];
    for (const int i : u_) *h++ = u[i];
}

bool Limits::values(const Point& at, Numbers& h) {
    bool ok = true;
    for (int n = 0; n < problem_.N; ++n) {
        double* of_stage = h.data() + n * rows_;
        copy_values(n, at, of_stage);
        if (nh_) ok = call_path(n, at, of_stage + rows_ - nh_, nullptr, nullptr) && ok;
    }
    if (num_guards_) ok = call_guard(at, h.data() + problem_.N * rows_, nullptr, nullptr) && ok;
    return ok;
}

bool Limits::evaluate(const Point& at, const Numbers& lambda, Numbers& h) {
    const int N = problem_.N, nd = problem_.ndx, px = padded(nd);
    const int nlx = static_cast<int>(x_.size()), nlu = static_cast<int>(u_.size());
    bool ok = true;
    std::fill(gradient_x_.begin(), gradient_x_.end(), 0.0), std::fill(gradient_u_.begin(), gradient_u_.end(), 0.0);
    std::fill(H_.begin(), H_.end(), 0.0);
    for (int n = 0; n < N; ++n) {
        const double* of_rows = lambda.data() + n * rows_;
        double *of_stage = h.data() + n * rows_, *of_x = gradient_x_.data() + problem_.dx_offset(n);
        copy_values(n, at, of_stage);
        for (int i = 0; i < nlx; ++i) of_x[x_[i]] += of_rows[i];
        for (int i = 0; i < nlu; ++i) gradient_u_[problem_.u_offset[n] + u_[i]] += of_rows[nlx + i];
        if (!nh_) continue;
        double* J = J_.data() + static_cast<std::size_t>(n) * nh_ * px;
        std::copy(of_rows + nlx + nlu, of_rows + rows_, lambda_.begin());
        ok = call_path(n, at, of_stage + nlx + nlu, J, H_.data() + matrix_offset(n)) && ok;
        for (int i = 0; i < nh_; ++i) dense::axpy(nd, lambda_[i], J + i * px, of_x);
    }
    if (!num_guards_) return ok;
    std::copy(lambda.begin() + N * rows_, lambda.end(), lambda_.begin());
    ok = call_guard(at, h.data() + N * rows_, guard_J_.data(), H_.data() + matrix_offset(N - 1)) && ok;
    double* of_x = gradient_x_.data() + problem_.dx_offset(N - 1);
    for (int i = 0; i < num_guards_; ++i) dense::axpy(nd, lambda_[i], guard_J_.data() + i * px, of_x);
    return ok;
}

void Limits::along(const Increment& d, Numbers& rows) const {
    const int N = problem_.N, nd = problem_.ndx, px = padded(nd);
    for (int n = 0; n < N; ++n) {
        double* out = rows.data() + n * rows_;
        const double* dx = d.dx.data() + problem_.dx_offset(n + 1);
        for (const int i : x_) *out++ = dx[i];
        for (const int i : u_) *out++ = d.du[problem_.u_offset[n] + i];
        for (int i = 0; i < nh_; ++i) *out++ = dense::dot(nd, jacobian(n) + i * px, dx);
    }
    const double* dx = d.dx.data() + problem_.dx_offset(N);
    for (int i = 0; i < num_guards_; ++i) rows[N * rows_ + i] = dense::dot(nd, guard_J_.data() + i * px, dx);
}

void Limits::add_transposed(const Numbers& weights, Residual& out) const {
    const int N = problem_.N, nd = problem_.ndx, px = padded(nd);
    for (int n = 0; n < N; ++n) {
        const double* weight = weights.data() + n * rows_;
        double* w = out.w.data() + problem_.m_offset[n];
        double* of_u = out.s.data() + problem_.s_offset(n) + nd;
        for (const int i : x_) w[i] += *weight++;
        for (const int i : u_) of_u[i] += *weight++;
        for (int i = 0; i < nh_; ++i) dense::axpy(nd, *weight++, jacobian(n) + i * px, w);
    }
    double* w = out.w.data() + problem_.m_offset[N - 1];
    for (int i = 0; i < num_guards_; ++i) dense::axpy(nd, weights[N * rows_ + i], guard_J_.data() + i * px, w);
}

void Limits::weigh(const Numbers& weights) {
    const int N = problem_.N, nd = problem_.ndx, px = padded(nd);
    const auto add_outer = [&](double weight, const double* row, double* B) {
        for (int i = 0; i < nd; ++i)
            if (row[i] != 0.0) dense::axpy(nd, weight * row[i], row, B + i * px);
    };
    B_ = H_;
    for (int n = 0; nh_ && n < N; ++n)
        for (int i = 0; i < nh_; ++i)
            add_outer(weights[(n + 1) * rows_ - nh_ + i], jacobian(n) + i * px, B_.data() + matrix_offset(n));
    for (int i = 0; i < num_guards_; ++i)
        add_outer(weights[N * rows_ + i], guard_J_.data() + i * px, B_.data() + matrix_offset(N - 1));
}

void Limits::add_to_value(int n, const Numbers& weights, double* P) const {
    const int px = padded(problem_.ndx);
    for (std::size_t i = 0; i < x_.size(); ++i) P[x_[i] * px + x_[i]] += weights[n * rows_ + i];
    const double* B = matrix(n);
    for (int i = 0; B && i < problem_.ndx * px; ++i) P[i] += B[i];
}

void Limits::add_products(int n, const Numbers& weights, const double* dx, const double* du, double* Hx,
                          double* Hu) const {
    const double* weight = weights.data() + n * rows_;
    for (const int i : x_) Hx[i] += *weight++ * dx[i];
    for (const int i : u_) Hu[i] += *weight++ * du[i];
    if (const double* B = matrix(n)) dense::gemv(problem_.ndx, problem_.ndx, B, padded(problem_.ndx), dx, Hx);
}

}  // namespace mbocp
