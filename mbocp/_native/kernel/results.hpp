// What the kernel's operations say of their outcome.
#pragma once

namespace mbocp {

// What the line search looks at: with limits the objective is the cost with its barrier.
struct Trial {
    double objective = 0, violation = 0;
    bool finite = false;

    bool is_feasible() const { return violation <= 1e-9; }
};

struct Evaluation : Trial {
    double cost = 0, residual = 0, primal = 0, dual = 0, worst = 0;
    int worst_stage = -1, worst_row = -1;  // stage -1: the end condition; rows beyond a stage's own: its limits
    // With limits: the largest defect of the optimality conditions of the barrier problem; the norm of multipliers
    // times distances, which `dual` contains.
    double barrier_error = 0, complementarity = 0;
};

struct Factorisation {
    int negative = 0;             // negative eigenvalues of the control Hessians plus those of eta's Schur complement
    double smallest_pivot = 0.0;  // relative, over the stages' step matrices
    // Relative size of the smallest eigenvalue of eta's (equilibrated) Schur complement; where it is above 2e-3,
    // perhaps a bound below it that is, too.
    double end_condition = 1.0;
    bool ok = false;
    int bad_stage = -1;       // where a matrix was singular; num_stages: the end condition
    double augmentation = 0;  // the end condition's weight
};

struct Direction {
    double increment = 0, slope = 0, curvature = 0, linear_residual = 0;  // slope of the objective
    double turn = 0;                       // angle by which it turns the joint that it turns most [rad]
    double longest = 1, longest_dual = 1;  // steps that keep slacks and limits' multipliers positive
    bool finite = false;
};

// Euclidean norms of the unknowns: of states and controls; of all multipliers, in the reported scaling.
struct Sizes {
    double primal = 0, dual = 0;
};

struct Sweep {
    bool ok = false;
    int failed_stage = -1, iterations = 0;
    double residual = 0;
};

}  // namespace mbocp
