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
    // Weighs with what delta of equations goes by, which otherwise the first factorisation at an iterate finds.
    void learn() {
        riccati.learn();
        weigh(barrier.parameter());
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
    // and of the limits that are equations.
    static constexpr std::size_t num_parts = 6;
    static constexpr double grain = 0x1p-46;  // of an entry: what is less beside it is round-off
    using Parts = std::array<Numbers, num_parts>;
    // The solutions, each by its size, are added up, and K is solved for what is left of that: by so much round-off
    // makes them wrong, which is much where K is nearly singular. Multipliers of limits have no part in that: where
    // limits follow from others, these are some of many. Nor has a solution that is next to nothing beside these:
    // limits bear all of its right-hand side, and the rest is round-off.
    struct Solved {
        Parts parts;
        Numbers of_start;  // K's rows of the given state times each solution
        double left = 0;   // the largest that is left of one
        // Entries of each part: what round-off makes of the sum, and of its terms.
        Numbers apart = Numbers(num_parts - 1, 0.0), largest = apart;
    };
    Solved solve_for(const Parts& rhs, int count) {
        const auto sizes = part_sizes();
        Solved found;
        for (std::size_t part = 0; part < num_parts; ++part) {
            if (rhs[part].size() != sizes[part] * count) throw std::invalid_argument("solve_for: wrong length");
            found.parts[part].reserve(rhs[part].size());
        }
        Residual residual(problem), left(problem);
        for (int k = 0; k < count; ++k) {
            std::array<const double*, num_parts> given;
            for (std::size_t part = 0; part < num_parts; ++part) given[part] = rhs[part].data() + sizes[part] * k;
            found.left = std::max(found.left, solve_one(given, residual));
            const KktCheck& check = riccati.check();
            const auto steps = part_steps(riccati.direction());
            for (std::size_t part = 0; part < num_parts; ++part)
                found.parts[part].insert(found.parts[part].end(), steps[part], steps[part] + sizes[part]);
            found.of_start.insert(found.of_start.end(), check.of_start.begin(), check.of_start.end());
            const Numbers sizes_of_parts = largest_of(steps);
            const double size = std::max({sizes_of_parts[0], sizes_of_parts[1], sizes_of_parts[2]});
            if (size <= grain * sizes_of_parts.back()) continue;
            for (std::size_t part = 0; part < num_parts - 1; ++part)
                found.largest[part] = std::max(found.largest[part], sizes_of_parts[part] / size);
            left.add(1.0 / size, check.left);
        }
        const Numbers apart = largest_of(part_steps(riccati.correction_for(left)));
        found.apart.assign(apart.begin(), apart.end() - 1);
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

private:
    std::array<std::size_t, num_parts> part_sizes() const {
        return {problem.of_nodes(problem.ndx) - problem.ndx,
                iterate.y.size(),
                iterate.u.size(),
                iterate.m.size(),
                iterate.eta.size(),
                barrier.equation_step().size()};
    }
    std::array<const double*, num_parts> part_steps(const Increment& d) const {
        return {d.dx.data() + problem.ndx,     d.dy.data(), d.du.data(), d.dm.data(), d.deta.data(),
                barrier.equation_step().data()};
    }
    // NaN where there is one.
    Numbers largest_of(const std::array<const double*, num_parts>& steps) const {
        const auto sizes = part_sizes();
        Numbers found;
        for (std::size_t part = 0; part < num_parts; ++part) {
            double most = 0;
            for (std::size_t at = 0; at < sizes[part]; ++at)
                if (const double size = std::abs(steps[part][at]); size > most || std::isnan(size)) most = size;
            found.push_back(most);
        }
        return found;
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
