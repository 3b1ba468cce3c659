// Where Newton's method stands.
#pragma once

#include <cmath>
#include <memory>
#include <optional>

#include "centring.hpp"
#include "programme.hpp"

namespace mbocp {

// An iterate, to go back to.
struct Kept {
    explicit Kept(const Programme& programme)
        : iterate(programme.iterate), slack(programme.barrier.slack), z_lower(programme.barrier.z_lower),
          z_upper(programme.barrier.z_upper) {}
    void restore(Programme& programme) const {
        programme.iterate = iterate;
        programme.barrier.slack = slack, programme.barrier.z_lower = z_lower, programme.barrier.z_upper = z_upper;
    }

    Iterate iterate;
    Numbers slack, z_lower, z_upper;
};

// Where a run of relaxed steps began, to go back to when it leads nowhere.
struct Reference {
    std::shared_ptr<const Kept> kept;
    Evaluation evaluation;
    int steps_left;  // that may still be taken
};

// How a run ends. The names are those of mbocp/solvers/records.py.
enum class Status { converged, max_iterations, diverged, singular, line_search_failed };

struct NewtonState {
    static constexpr double infinite = std::numeric_limits<double>::infinity();

    std::shared_ptr<Programme> programme;  // holds the iterate
    Evaluation evaluation;                 // of it
    Filter filter;
    int iteration = 0;                                                              // Newton steps taken
    double increment = infinite, step_length = std::nan(""), regularisation = 0.0;  // of the last step
    double augmentation = 0.0;           // weight rho of the end condition inside the factorisation
    double shift = 0.0;                  // where the search for an admissible shift begins; 0: the plain Hessian
    double last_shift = 0.0;             // the last one that a step was taken with
    bool began_large = false;            // the first step took a large one
    bool falls_fast = false;             // it began large, and steps have been full since it was so last
    std::optional<Reference> reference;  // while a run of relaxed steps is under way
    int patience = 0;                    // steps until another such run may begin
    bool at_minimum = false;             // the last KKT matrix had a minimum's inertia without any shift
    double contraction = infinite;       // of the residual, by the last step; infinite if that was no full step
    int still = 0;                       // steps in a row, without a shift, that halved neither residual nor increment
    int restarts = 0;                    // how often the multipliers have been started anew
    double barrier = 0.0;                // parameter mu of the limits' barrier; 0: there are no limits
    double least_barrier = 0.0;        // below which round-off makes the system singular, as far as that has been found
    int barrier_since = 0;             // iteration with which mu fell last
    std::optional<Centring> centring;  // none: mu falls by a rule, and the first limit in the way cuts a step
    std::optional<Status> failure;     // why no step could be taken
    int factorisations = 0, corrections = 0;  // tried so far
    int failed_stage = -1;                    // where, for a singular system; num_stages: the end condition

    // Whether slacks stop at their bounds, each by itself, rather than that a step is cut.
    bool may_stop() const { return centring.has_value(); }
    // Whether the next step chooses mu.
    bool is_free() const { return centring && centring->is_free() && !reference; }
    // What the next increment will be, as a Newton step leaves the matrix nearly as it is; or infinite.
    double next_increment() const {
        return regularisation == 0.0 && barrier == 0.0 ? increment * contraction : infinite;
    }
};

}  // namespace mbocp
