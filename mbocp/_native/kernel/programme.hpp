// A stagewise programme with its iterate, and all that can be done to them; what Python sees.
#pragma once

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
