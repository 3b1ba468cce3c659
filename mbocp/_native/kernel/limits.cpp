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

constexpr double infinity = std::numeric_limits<double>::infinity();

// Entries of a row of bounds that are bounded in stage n.
std::vector<int> limited(const Numbers& lower, const Numbers& upper, int n, int size, const std::string& name) {
    const int first = static_cast<int>(lower.size()) == size ? 0 : n * size;
    std::vector<int> found;
    for (int i = 0; i < size; ++i) {
        const double low = lower[first + i], high = upper[first + i];
        if (!std::isfinite(low) && !std::isfinite(high)) continue;
        if (!(low <= high)) throw std::invalid_argument("limits of " + name + ": no room");
        found.push_back(i);
    }
    return found;
}

void check_length(const Numbers& lower, const Numbers& upper, int N, int size, const std::string& name) {
    const int length = static_cast<int>(lower.size());
    if ((length != size && length != N * size) || lower.size() != upper.size())
        throw std::invalid_argument("limits of " + name + ": wrong length");
}

// The values h that a function has just returned in a lane, its first output.
void read_values(const StageFunction& f, int lane, double* h) {
    const auto& rows = f.outputs[0];
    for (int k = 0; k < rows.nnz(); ++k) h[rows.row[k]] = f.values(0)[k * f.num_lanes + lane];
}

void extend(Window& window, int first, int end) {
    if (window.size > 0) first = std::min(first, window.first), end = std::max(end, window.first + window.size);
    window.first = first, window.size = end - first;
}

// Whole vectors, as far as there are nd columns, one after another; returns how many numbers these are.
std::size_t lay_out(std::vector<Window>& windows, int nd) {
    int at = 0;
    for (Window& window : windows) {
        const int end = std::min(padded(window.first + window.size), nd);
        if (window.size > 0) window.first -= window.first % dense::width, window.size = end - window.first;
        window.at = at, at += padded(window.size);
    }
    return static_cast<std::size_t>(at);
}

// Of the rows of a function (..., m, ...) -> h, dh_dx, upper Hessian of m'h.
std::vector<Window> windows_of(const StageFunction& f) {
    const Pattern& slopes = f.outputs[1];
    std::vector<Window> found(static_cast<std::size_t>(slopes.rows), Window{});
    for (int k = 0; k < slopes.nnz(); ++k)
        extend(found[static_cast<std::size_t>(slopes.row[k])], slopes.column[k], slopes.column[k] + 1);
    return found;
}

// Where the derivatives that such a function returns belong, among those in windows of its rows.
Places places_of_slopes(const StageFunction& f, const std::vector<Window>& windows) {
    const Pattern& slopes = f.outputs[1];
    Places places;
    for (int k = 0; k < slopes.nnz(); ++k) {
        const Window& window = windows[static_cast<std::size_t>(slopes.row[k])];
        places.push_back({f.first[1] + k, window.at + slopes.column[k] - window.first});
    }
    return places;
}

// The same of its Hessian, both halves of which are in windows of the rows of a matrix.
Places places_of_curvature(const StageFunction& f, const std::vector<Window>& windows) {
    const Pattern& curvature = f.outputs[2];
    Places places;
    const auto add = [&](int k, int i, int j) {
        const Window& window = windows[static_cast<std::size_t>(i)];
        places.push_back({f.first[2] + k, window.at + j - window.first});
    };
    for (int k = 0; k < curvature.nnz(); ++k) {
        const int i = curvature.row[k], j = curvature.column[k];
        add(k, i, j);
        if (i != j) add(k, j, i);
    }
    return places;
}

int place_of_zero(const StageFunction& f) { return f.first.back() + f.outputs.back().nnz(); }

double times(const Slope& J, const double* dx) { return dense::dot(J.size, J.values, dx + J.first); }

void add_multiple(double weight, const Slope& J, double* sum) { dense::axpy(J.size, weight, J.values, sum + J.first); }

}  // namespace

void Limits::set(const Bounds& bounds, Function path, Function path_values, Function guard) {
    const int N = problem_.N, nx = problem_.nx, nu = problem_.kind().nu;
    if (nx != problem_.ndx) throw std::invalid_argument("limits: states must be plain vectors");
    if (!bounds.path_lower.empty() && !(path && path_values))
        throw std::invalid_argument("limits: the path functions are missing");
    if (bounds.num_guards && !guard) throw std::invalid_argument("limits: the guards are missing");
    nh_ = path ? path->outputs[0].rows : 0, num_guards_ = bounds.num_guards;
    check_length(bounds.x_lower, bounds.x_upper, N, nx, "states");
    check_length(bounds.u_lower, bounds.u_upper, N, nu, "controls");
    check_length(bounds.path_lower, bounds.path_upper, N, nh_, "path functions");
    path_ = std::move(path), path_values_ = std::move(path_values), guard_ = std::move(guard);

    lower.clear(), upper.clear(), equations.clear(), of_equation_.clear(), stages_.clear(), entry_.clear();
    with_path_.clear();
    at_node_.assign(static_cast<std::size_t>(N), -1);
    first_equation_.assign(1, 0);
    int nodes = 0;
    bool has_states = num_guards_ > 0;
    for (int n = 0; n < N; ++n) {
        const std::vector<int> x = limited(bounds.x_lower, bounds.x_upper, n, nx, "states"),
                               u = limited(bounds.u_lower, bounds.u_upper, n, nu, "controls"),
                               h = limited(bounds.path_lower, bounds.path_upper, n, nh_, "path functions");
        Rows rows{};
        rows.x = first_guard(), add_rows(n, x, bounds.x_lower, bounds.x_upper, nx);
        rows.u = first_guard(), add_rows(n, u, bounds.u_lower, bounds.u_upper, nu);
        rows.path = first_guard(), add_rows(n, h, bounds.path_lower, bounds.path_upper, nh_);
        rows.end = first_guard();
        stages_.push_back(rows);
        first_equation_.push_back(static_cast<int>(equations.size()));
        if (!h.empty()) at_node_[n] = nodes++, with_path_.push_back(n);
        has_states = has_states || !x.empty() || !h.empty();
    }
    if (problem_.is_structured() && has_states)
        throw std::invalid_argument("limits: where stages have a structure, only controls can have any");
    lower.insert(lower.end(), num_guards_, 0.0);
    upper.insert(upper.end(), num_guards_, infinity);

    const int nd = problem_.ndx;
    matrix_rows_.assign(static_cast<std::size_t>(nd), Window{});
    windows_ = path_ ? windows_of(*path_) : std::vector<Window>();
    guard_windows_ = guard_ ? windows_of(*guard_) : std::vector<Window>();
    num_slopes_ = lay_out(windows_, nd);
    guard_J_.assign(lay_out(guard_windows_, nd), 0.0);
    if (path_) add_to_matrix(*path_, windows_);
    if (guard_) add_to_matrix(*guard_, guard_windows_);
    size_of_matrix_ = lay_out(matrix_rows_, nd);
    if (path_) {
        slopes_ = Scatter(places_of_slopes(*path_, windows_), place_of_zero(*path_));
        curvature_ = Scatter(places_of_curvature(*path_, matrix_rows_), place_of_zero(*path_));
    }
    const std::size_t matrices = nodes + (num_guards_ && at_node_.back() < 0);
    const int num_threads = problem_.crew().size();
    may_share_ = path_ && path_->copy_for(num_threads) && path_values_->copy_for(num_threads);
    own_.assign(num_threads, {Numbers(nh_, 0.0), Numbers(nh_ * most_lanes, 0.0)});
    guard_lambda_.assign(num_guards_, 0.0);
    gradient_x_.assign(problem_.dx_offset(N), 0.0), gradient_u_.assign(problem_.u_offset[N], 0.0);
    J_.assign(num_slopes_ * nodes, 0.0), H_.assign(matrices * size_of_matrix_, 0.0), B_ = H_;
}

// What J'J and the Hessian of such rows can fill.
void Limits::add_to_matrix(const StageFunction& f, const std::vector<Window>& windows) {
    const Pattern &slopes = f.outputs[1], &curvature = f.outputs[2];
    const auto add = [&](int row, int first, int end) {
        extend(matrix_rows_[static_cast<std::size_t>(row)], first, end);
    };
    for (int k = 0; k < slopes.nnz(); ++k) {
        const Window& window = windows[static_cast<std::size_t>(slopes.row[k])];
        add(slopes.column[k], window.first, window.first + window.size);
    }
    for (int k = 0; k < curvature.nnz(); ++k) {
        const int i = curvature.row[k], j = curvature.column[k];
        add(i, j, j + 1), add(j, i, i + 1);
    }
}

// The rows `found` of one stage, of `size` entries; equations get no sides.
void Limits::add_rows(int n, const std::vector<int>& found, const Numbers& lower_side, const Numbers& upper_side,
                      int size) {
    const int first = static_cast<int>(lower_side.size()) == size ? 0 : n * size;
    for (const int i : found) {
        const double low = lower_side[first + i], high = upper_side[first + i];
        const bool is_equation = low == high;
        if (is_equation) equations.push_back({first_guard(), low}), of_equation_.push_back(n);
        lower.push_back(is_equation ? -infinity : low), upper.push_back(is_equation ? infinity : high);
        entry_.push_back(i);
    }
}

std::size_t Limits::jacobian_offset(int n) const { return static_cast<std::size_t>(at_node_[n]) * num_slopes_; }

// Those of the guards come last where the last node has no path functions.
std::size_t Limits::matrix_offset(int n) const {
    return has_path(n) ? static_cast<std::size_t>(at_node_[n]) * size_of_matrix_ : H_.size() - size_of_matrix_;
}

const double* Limits::matrix(int n) const {
    return has_path(n) || (num_guards_ > 0 && n == problem_.N - 1) ? B_.data() + matrix_offset(n) : nullptr;
}

double Limits::squared_slope(std::size_t equation) const {
    const int row = equations[equation].row, n = of_equation_[equation];
    if (row < of_stage(n).path) return 1.0;
    const Slope J = slope(n, row);
    return dense::dot(J.size, J.values, J.values);
}

double Limits::response(std::size_t equation, const double* T, const double* Hss, int ld, int nd) const {
    const int row = equations[equation].row, n = of_equation_[equation], nu = problem_.kind().nu;
    const Rows rows = of_stage(n);
    const auto in_control = [&](int j) {
        if (row < rows.u) return T[entry(row) * ld + nd + j];
        if (row < rows.path) return entry(row) == j ? 1.0 : 0.0;
        const Slope J = slope(n, row);
        double sum = 0;
        for (int i = 0; i < J.size; ++i) sum += J.values[i] * T[(J.first + i) * ld + nd + j];
        return sum;
    };
    double sum = 0;
    for (int j = 0; j < nu; ++j) {
        const double a = in_control(j), weight = std::abs(Hss[(nd + j) * (ld + 1)]);
        if (a != 0.0) sum += a * a / weight;
    }
    return sum;
}

double Limits::reach(std::size_t equation, const Point& at) const {
    const int n = of_equation_[equation], row = equations[equation].row;
    const Rows rows = of_stage(n);
    if (row >= rows.u && row < rows.path) return std::abs(at.u[problem_.u_offset[n] + entry(row)]);
    return std::sqrt(squared_slope(equation)) * dense::largest(problem_.nx, at.x.data() + problem_.x_offset(n + 1));
}

void Limits::set_states(StageFunction& function, std::size_t first, const Point& at) const {
    const double* x[most_lanes];
    for (int lane = 0; lane < function.num_lanes; ++lane) {
        const std::size_t own = std::min(first + lane, with_path_.size() - 1);
        x[lane] = at.x.data() + problem_.x_offset(with_path_[own] + 1);
    }
    function.set(0, x);
}

bool Limits::call_guard(const Point& at, double* h, double* J, double* H) {
    guard_->share(0, at.x.data() + problem_.x_offset(problem_.N));
    guard_->share(1, guard_lambda_.data());
    guard_->share(2, problem_.rho_terminal.data());
    const bool ok = guard_->call_in_lanes(1);
    read_values(*guard_, 0, h);
    if (!J) return ok;
    const auto value = [&](const Place& place) { return guard_->all_values()[place.from * guard_->num_lanes]; };
    for (const Place& place : places_of_slopes(*guard_, guard_windows_)) J[place.to] = value(place);
    for (const Place& place : places_of_curvature(*guard_, matrix_rows_)) H[place.to] += value(place);
    return ok;
}

// Of limited states and controls.
void Limits::copy_values(int n, const Point& at, double* h) const {
    const double *x = at.x.data() + problem_.x_offset(n + 1), *u = at.u.data() + problem_.u_offset[n];
    const Rows rows = of_stage(n);
    for (int i = rows.x; i < rows.u; ++i) h[i] = x[entry(i)];
    for (int i = rows.u; i < rows.path; ++i) h[i] = u[entry(i)];
}

bool Limits::evaluate_values(std::size_t first, const Point& at, Numbers& h, int thread) {
    StageFunction& f = path_values_->of(thread);
    Own& own = own_[static_cast<std::size_t>(thread)];
    set_states(f, first, at);
    const bool ok = f.call_in_lanes(static_cast<int>(with_path_.size() - first));
    for (std::size_t k = first; k < std::min(first + f.num_lanes, with_path_.size()); ++k) {
        const Rows rows = of_stage(with_path_[k]);
        read_values(f, static_cast<int>(k - first), own.h.data());
        for (int i = rows.path; i < rows.end; ++i) h[i] = own.h[entry(i)];
    }
    return ok;
}

bool Limits::evaluate_group(std::size_t first, const Point& at, const Numbers& lambda, Numbers& h, int thread) {
    StageFunction& f = path_->of(thread);
    Own& own = own_[static_cast<std::size_t>(thread)];
    const std::size_t last = std::min(first + f.num_lanes, with_path_.size());
    std::fill(own.lambda.begin(), own.lambda.end(), 0.0);
    for (std::size_t k = first; k < last; ++k) {
        const Rows rows = of_stage(with_path_[k]);
        for (int i = rows.path; i < rows.end; ++i) own.lambda[(k - first) * nh_ + entry(i)] = lambda[i];
    }
    const int count = static_cast<int>(last - first);
    const double* of_lanes[most_lanes];
    double *of_slopes[most_lanes], *of_curvature[most_lanes];
    for (int lane = 0; lane < f.num_lanes; ++lane) {  // behind the last node it is repeated
        const std::size_t k = std::min(lane, count - 1);
        const int n = with_path_[first + k];
        of_lanes[lane] = own.lambda.data() + k * nh_;
        of_slopes[lane] = J_.data() + jacobian_offset(n), of_curvature[lane] = H_.data() + matrix_offset(n);
    }
    set_states(f, first, at), f.set(1, of_lanes);
    const bool ok = f.call_in_lanes(count);
    slopes_.apply(f.all_values(), f.num_lanes, count, of_slopes);
    curvature_.apply(f.all_values(), f.num_lanes, count, of_curvature);
    for (std::size_t k = first; k < last; ++k) {
        const int n = with_path_[k];
        const Rows rows = of_stage(n);
        read_values(f, static_cast<int>(k - first), own.h.data());
        for (int i = rows.path; i < rows.end; ++i) {
            h[i] = own.h[entry(i)];
            add_multiple(lambda[i], slope(n, i), gradient_x_.data() + problem_.dx_offset(n));
        }
    }
    return ok;
}

bool Limits::values(const Point& at, Numbers& h) {
    bool ok = true;
    for (int n = 0; n < problem_.N; ++n) copy_values(n, at, h.data());
    if (!with_path_.empty()) {
        const std::size_t num_lanes = path_values_->num_lanes, groups = (with_path_.size() + num_lanes - 1) / num_lanes;
        std::atomic<bool> all_ok{true};
        const auto begin = [&](int thread) {
            StageFunction& f = path_values_->of(thread);
            f.share(1, nullptr), f.share(2, problem_.theta.data());
        };
        problem_.crew().share(of_values_, static_cast<int>(groups), may_share_, begin,
                              [&](int thread, int first, int last) {
                                  for (int i = first; i < last; ++i)
                                      if (!evaluate_values(i * num_lanes, at, h, thread)) all_ok = false;
                              });
        ok = all_ok;
    }
    if (num_guards_) ok = call_guard(at, h.data() + first_guard(), nullptr, nullptr) && ok;
    return ok;
}

bool Limits::evaluate(const Point& at, const Numbers& lambda, Numbers& h) {
    const int N = problem_.N;
    bool ok = true;
    std::fill(gradient_x_.begin(), gradient_x_.end(), 0.0), std::fill(gradient_u_.begin(), gradient_u_.end(), 0.0);
    if (num_guards_) std::fill(H_.end() - static_cast<std::ptrdiff_t>(size_of_matrix_), H_.end(), 0.0);
    for (int n = 0; n < N; ++n) {
        const Rows rows = of_stage(n);
        double* of_x = gradient_x_.data() + problem_.dx_offset(n);
        copy_values(n, at, h.data());
        for (int i = rows.x; i < rows.u; ++i) of_x[entry(i)] += lambda[i];
        for (int i = rows.u; i < rows.path; ++i) gradient_u_[problem_.u_offset[n] + entry(i)] += lambda[i];
    }
    if (!with_path_.empty()) {
        const std::size_t num_lanes = path_->num_lanes, groups = (with_path_.size() + num_lanes - 1) / num_lanes;
        std::atomic<bool> all_ok{true};
        const auto begin = [&](int thread) {
            StageFunction& f = path_->of(thread);
            f.share(2, nullptr);  // zeros: what of a velocity a control prescribes is not limited
            f.share(3, problem_.theta.data());
        };
        problem_.crew().share(of_derivatives_, static_cast<int>(groups), may_share_, begin,
                              [&](int thread, int first, int last) {
                                  for (int i = first; i < last; ++i)
                                      if (!evaluate_group(i * num_lanes, at, lambda, h, thread)) all_ok = false;
                              });
        ok = all_ok;
    }
    if (!num_guards_) return ok;
    std::copy(lambda.begin() + first_guard(), lambda.end(), guard_lambda_.begin());
    ok = call_guard(at, h.data() + first_guard(), guard_J_.data(), H_.data() + matrix_offset(N - 1)) && ok;
    double* of_x = gradient_x_.data() + problem_.dx_offset(N - 1);
    for (int i = 0; i < num_guards_; ++i) add_multiple(guard_lambda_[i], guard_slope(i), of_x);
    return ok;
}

void Limits::along(const Increment& d, Numbers& rows) const {
    const int N = problem_.N;
    for (int n = 0; n < N; ++n) {
        const Rows of = of_stage(n);
        const double* dx = d.dx.data() + problem_.dx_offset(n + 1);
        for (int i = of.x; i < of.u; ++i) rows[i] = dx[entry(i)];
        for (int i = of.u; i < of.path; ++i) rows[i] = d.du[problem_.u_offset[n] + entry(i)];
        for (int i = of.path; i < of.end; ++i) rows[i] = times(slope(n, i), dx);
    }
    const double* dx = d.dx.data() + problem_.dx_offset(N);
    for (int i = 0; i < num_guards_; ++i) rows[first_guard() + i] = times(guard_slope(i), dx);
}

void Limits::add_transposed(const Numbers& weights, Residual& out) const {
    const int N = problem_.N, nd = problem_.ndx;
    for (int n = 0; n < N; ++n) {
        const Rows rows = of_stage(n);
        double* w = out.w.data() + problem_.m_offset[n];
        double* of_u = out.s.data() + problem_.s_offset(n) + nd;
        for (int i = rows.x; i < rows.u; ++i) w[entry(i)] += weights[i];
        for (int i = rows.u; i < rows.path; ++i) of_u[entry(i)] += weights[i];
        for (int i = rows.path; i < rows.end; ++i) add_multiple(weights[i], slope(n, i), w);
    }
    double* w = out.w.data() + problem_.m_offset[N - 1];
    for (int i = 0; i < num_guards_; ++i) add_multiple(weights[first_guard() + i], guard_slope(i), w);
}

void Limits::weigh(const Numbers& weights) {
    const int N = problem_.N;
    const auto add_outer = [&](double weight, const Slope& J, double* B) {
        for (int i = 0; i < J.size; ++i) {
            if (J.values[i] == 0.0) continue;
            const Window& row = matrix_rows_[static_cast<std::size_t>(J.first + i)];
            dense::axpy(J.size, weight * J.values[i], J.values, B + row.at + J.first - row.first);
        }
    };
    const auto copy = [&](int n) {
        double* B = B_.data() + matrix_offset(n);
        dense::copy(H_.data() + matrix_offset(n), B, static_cast<int>(size_of_matrix_));
        return B;
    };
    if (matrix(N - 1) && !has_path(N - 1)) copy(N - 1);
    problem_.crew().share(
        of_products_, static_cast<int>(with_path_.size()), true, [](int) {},
        [&](int, int first, int last) {
            for (int k = first; k < last; ++k) {
                const int n = with_path_[k];
                const Rows rows = of_stage(n);
                double* B = copy(n);
                for (int i = rows.path; i < rows.end; ++i) add_outer(weights[i], slope(n, i), B);
            }
        });
    for (int i = 0; i < num_guards_; ++i)
        add_outer(weights[first_guard() + i], guard_slope(i), B_.data() + matrix_offset(N - 1));
}

void Limits::add_to_value(int n, const Numbers& weights, double* P) const {
    const int px = padded(problem_.ndx);
    const Rows rows = of_stage(n);
    for (int i = rows.x; i < rows.u; ++i) P[entry(i) * px + entry(i)] += weights[i];
    for_rows_of_matrix(n, [&](int i, const Slope& B) { add_multiple(1.0, B, P + i * px); });
}

void Limits::add_products(int n, const Numbers& weights, const double* dx, const double* du, double* Hx,
                          double* Hu) const {
    const Rows rows = of_stage(n);
    for (int i = rows.x; i < rows.u; ++i) Hx[entry(i)] += weights[i] * dx[entry(i)];
    for (int i = rows.u; i < rows.path; ++i) Hu[entry(i)] += weights[i] * du[entry(i)];
    for_rows_of_matrix(n, [&](int i, const Slope& B) {
        dense::Vec lanes;
        dense::multiply_rows<1>(B.size, B.values, padded(B.size), dx + B.first, &lanes);
        Hx[i] += dense::sum_of(lanes);
    });
}

}  // namespace mbocp
