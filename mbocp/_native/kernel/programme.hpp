// A stagewise programme with its iterate, and all that can be done to them; what Python sees.
#pragma once

#include <array>
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
    using Parts = std::array<Numbers, 6>;
    std::pair<Parts, double> solve_for(const Parts& rhs, int count) {
        const std::size_t nodes = problem.of_nodes(problem.ndx) - problem.ndx;
        const std::array<std::size_t, 6> sizes{nodes,
                                               iterate.y.size(),
                                               iterate.u.size(),
                                               iterate.m.size(),
                                               iterate.eta.size(),
                                               barrier.equation_step().size()};
        Parts found;
        double left = 0;
        for (std::size_t part = 0; part < sizes.size(); ++part) {
            if (rhs[part].size() != sizes[part] * count) throw std::invalid_argument("solve_for: wrong length");
            found[part].reserve(rhs[part].size());
        }
        Residual residual(problem);
        Numbers equations(sizes[5]);
        const int ndx = problem.ndx, ny = problem.kind().ny, nu = problem.kind().nu;
        for (int k = 0; k < count; ++k) {
            const auto of = [&](std::size_t part) { return rhs[part].data() + sizes[part] * k; };
            for (int n = 0; n < problem.N; ++n) {
                double* w = residual.w.data() + problem.m_offset[n];
                std::copy_n(of(0) + static_cast<std::size_t>(n) * ndx, ndx, w);
                std::copy_n(of(1) + problem.y_offset[n], ny, w + ndx);
                std::copy_n(of(2) + problem.u_offset[n], nu, residual.s.data() + problem.s_offset(n) + ndx);
            }
            std::copy_n(of(3), sizes[3], residual.c.begin());
            std::copy_n(of(4), sizes[4], residual.g.begin());
            std::copy_n(of(5), sizes[5], equations.begin());
            left = std::max(left, riccati.solve_for(residual, equations));
            const Increment& d = riccati.direction();
            const std::array<const double*, 6> steps{d.dx.data() + ndx, d.dy.data(),   d.du.data(),
                                                     d.dm.data(),       d.deta.data(), barrier.equation_step().data()};
            for (std::size_t part = 0; part < sizes.size(); ++part)
                found[part].insert(found[part].end(), steps[part], steps[part] + sizes[part]);
        }
        return {std::move(found), left};
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
};

}  // namespace mbocp
