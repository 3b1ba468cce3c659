// A stagewise programme with its iterate, and all that can be done to them; what Python sees.
#pragma once

#include <array>
#include <cmath>
#include <stdexcept>

#include "adjoint_sweep.hpp"
#include "evaluator.hpp"
#include "forward_sweep.hpp"
#include "reduced_hessian.hpp"
#include "riccati.hpp"
#include "sizes.hpp"
#include "trial_point.hpp"

namespace mbocp {

class Programme {
public:
    Programme(int num_stages, Kind kind, Terminal terminal, Function retract, Function difference, int num_threads = 1)
        : problem(num_stages, std::move(kind), std::move(terminal), std::move(retract), std::move(difference),
                  num_threads) {}
    Programme(const Programme&) = delete;  // its parts refer to one another
    Programme& operator=(const Programme&) = delete;

    // Functions and derivatives at the iterate, with multipliers in the Hessian scaled by `share`.
    Evaluation evaluate(double share) {
        riccati.forget();
        return evaluator.evaluate(share);
    }
    Evaluation weigh(double parameter) {
        riccati.forget_residual();
        return evaluator.weigh(parameter);
    }
    // The same with the factors at hand, see `Barrier::aim`.
    Evaluation aim(double parameter, bool is_curved) {
        riccati.forget_right_hand_side();
        return evaluator.aim(parameter, is_curved);
    }
    // Second-order correction: the direction for constraint values alpha c + c(trial).
    Direction correct(double alpha) { return riccati.correct(alpha, trial_point.c(), trial_point.g()); }
    Sizes sizes() const { return sizes_of(problem, iterate, barrier); }
    bool move(double alpha) { return trial_point.move(riccati.direction(), alpha); }
    Trial trial(double alpha) { return trial_point.evaluate(riccati.direction(), alpha); }
    void accept(double alpha, double alpha_limits) { trial_point.accept(riccati.direction(), alpha, alpha_limits); }
    Sweep simulate(double tolerance, int max_iterations, bool warm, bool feedback, bool compensated) {
        riccati.forget();
        return forward_sweep.run(tolerance, max_iterations, warm, feedback, compensated);
    }
    Evaluation gradient(bool auxiliary, bool feedback) {
        riccati.forget();
        return adjoint_sweep.run(auxiliary, feedback);
    }
    // What the controls answer to a deviation of the state before, du = K dx, of the last factorisation: stage after
    // stage, a row a control.
    Numbers gains() const {
        Numbers found, dx(problem.ndx), du;
        for (int n = 0; n < problem.N; ++n) {
            const int nu = problem.kind().nu;
            const std::size_t first = found.size();
            found.resize(first + static_cast<std::size_t>(nu) * problem.ndx);
            for (int j = 0; j < problem.ndx; ++j) {
                du.assign(nu, 0.0);
                dx[j] = 1.0;
                riccati.elimination().feed_back(n, dx.data(), du.data());
                dx[j] = 0.0;
                for (int i = 0; i < nu; ++i) found[first + static_cast<std::size_t>(i) * problem.ndx + j] = du[i];
            }
        }
        return found;
    }
    // K d = rhs with the last factors, for `count` right-hand sides one after the other. Parts of rows and of unknowns
    // are the states of the nodes 1..N, algebraic unknowns, controls, multipliers of the steps, of the end condition,
    // and of the limits that are equations. Also the largest that is left of one.
    static constexpr std::size_t num_parts = 6;
    static constexpr double grain = 0x1p-46;  // of an entry: what is less beside it is round-off
    using Parts = std::array<Numbers, num_parts>;
    std::pair<Parts, double> solve_for(const Parts& rhs, int count) {
        const auto sizes = part_sizes();
        Parts found;
        double left = 0;
        for (std::size_t part = 0; part < num_parts; ++part) {
            if (rhs[part].size() != sizes[part] * count) throw std::invalid_argument("solve_for: wrong length");
            found[part].reserve(rhs[part].size());
        }
        Residual residual(problem);
        for (int k = 0; k < count; ++k) {
            std::array<const double*, num_parts> given;
            for (std::size_t part = 0; part < num_parts; ++part) given[part] = rhs[part].data() + sizes[part] * k;
            left = std::max(left, solve_one(given, residual));
            const auto steps = part_steps();
            for (std::size_t part = 0; part < num_parts; ++part)
                found[part].insert(found[part].end(), steps[part], steps[part] + sizes[part]);
        }
        return {std::move(found), left};
    }
    // What these solutions, each by three times its size, add up to, beside the solution of what their right-hand
    // sides add up to. That has other round-off, which shows how much of it is in the solutions where K is nearly
    // singular. Of each part how far the two are apart, and the largest term. Multipliers of limits are left out: where
    // limits follow from others, these are some of many. A solution that is next to nothing beside these is left out,
    // too: limits bear all of its right-hand side, and the rest is round-off.
    std::pair<Numbers, Numbers> compare_sums(const Parts& rhs, const Parts& found, int count) {
        const auto sizes = part_sizes();
        Numbers shares;
        for (int k = 0; k < count; ++k) {
            const auto largest_of = [&](std::size_t part) {
                return dense::largest(static_cast<int>(sizes[part]), found[part].data() + sizes[part] * k);
            };
            double size = 0;
            for (std::size_t part = 0; part < 3; ++part) size = std::max(size, largest_of(part));
            shares.push_back(size <= grain * largest_of(num_parts - 1) ? 0.0 : 1.0 / (3.0 * size));
        }
        Parts whole;
        std::array<const double*, num_parts> given;
        for (std::size_t part = 0; part < num_parts; ++part) {
            if (rhs[part].size() != sizes[part] * count || found[part].size() != rhs[part].size())
                throw std::invalid_argument("compare_sums: wrong length");
            whole[part].assign(sizes[part], 0.0);
            for (std::size_t at = 0; at < rhs[part].size(); ++at)
                whole[part][at % sizes[part]] += shares[at / sizes[part]] * rhs[part][at];
            given[part] = whole[part].data();
        }
        Residual residual(problem);
        solve_one(given, residual);
        const auto steps = part_steps();
        Numbers apart(num_parts - 1, 0.0), largest(apart);
        for (std::size_t part = 0; part < apart.size(); ++part)
            for (std::size_t at = 0; at < sizes[part]; ++at) {
                double left = -steps[part][at];
                for (int k = 0; k < count; ++k) {
                    const double term = shares[k] * found[part][sizes[part] * k + at];
                    left += term, largest[part] = std::max(largest[part], std::abs(term));
                }
                if (std::abs(left) > apart[part] || std::isnan(left)) apart[part] = std::abs(left);
            }
        return {std::move(apart), std::move(largest)};
    }
    Numbers reduced_hessian(double shift) {
        riccati.forget();
        return mbocp::reduced_hessian(problem, data, *step, shift);
    }

    Problem problem;
    Iterate iterate{problem};
    Data data{problem};
    std::unique_ptr<Step> step = make_step(problem, data);
    Barrier barrier{problem};
    Evaluator evaluator{problem, iterate, data, *step, barrier};
    Riccati riccati{problem, data, *step, barrier};
    TrialPoint trial_point{problem, iterate, barrier};
    ForwardSweep forward_sweep{problem, iterate, *step, riccati.elimination()};
    AdjointSweep adjoint_sweep{problem, iterate, data, *step, riccati.elimination()};

private:
    std::array<std::size_t, num_parts> part_sizes() const {
        return {problem.of_nodes(problem.ndx) - problem.ndx,
                iterate.y.size(),
                iterate.u.size(),
                iterate.m.size(),
                iterate.eta.size(),
                barrier.equation_step().size()};
    }
    std::array<const double*, num_parts> part_steps() const {
        const Increment& d = riccati.direction();
        return {d.dx.data() + problem.ndx,     d.dy.data(), d.du.data(), d.dm.data(), d.deta.data(),
                barrier.equation_step().data()};
    }
    double solve_one(const std::array<const double*, num_parts>& rhs, Residual& residual) {
        const int ndx = problem.ndx, ny = problem.kind().ny, nu = problem.kind().nu;
        for (int n = 0; n < problem.N; ++n) {
            double* w = residual.w.data() + problem.m_offset[n];
            std::copy_n(rhs[0] + static_cast<std::size_t>(n) * ndx, ndx, w);
            std::copy_n(rhs[1] + problem.y_offset[n], ny, w + ndx);
            std::copy_n(rhs[2] + problem.u_offset[n], nu, residual.s.data() + problem.s_offset(n) + ndx);
        }
        std::copy_n(rhs[3], iterate.m.size(), residual.c.begin());
        std::copy_n(rhs[4], iterate.eta.size(), residual.g.begin());
        return riccati.solve_for(residual, Numbers(rhs[5], rhs[5] + barrier.equation_step().size()));
    }
};

}  // namespace mbocp
