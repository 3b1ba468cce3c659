// A horizon that moves on: its motion is shifted in time, begins at a given state, and takes a few exact Newton steps,
// with limits by a barrier whose parameter falls no further than to a given one. After construction nothing is
// allocated, and nothing is thrown: what became of a step is in its status.
#pragma once

#include <chrono>
#include <limits>

#include "programme.hpp"

namespace mbocp {

// What a step of the horizon came to.
enum class Outcome {
    converged,    // the last increment is below the tolerance
    improved,     // all Newton steps were taken that were asked for
    out_of_time,  // fewer, since another one would have ended after the deadline
    stuck,        // no step improves cost or constraints, or the system is singular
    not_finite,   // functions or derivatives are not finite, or have failed
    bad_state,    // the given state is not finite: the predicted one has taken its place
    moved_on,     // no Newton step was asked for
};

struct HorizonStatus {
    Outcome outcome = Outcome::improved;
    int iterations = 0;
    // Of the last Newton step, NaN without one; what it leaves in the constraints (l1 norm) and the objective there.
    double increment = unknown, length = unknown, violation = unknown, objective = unknown;
    double barrier = 0, shift = 0, seconds = 0;  // parameter, shift of the Hessian, time of all [s]

    static constexpr double unknown = std::numeric_limits<double>::quiet_NaN();
};

struct HorizonSettings {
    double tolerance;     // of an increment
    double barrier;       // part of the cost that the barriers of all limits may take together
    double shift_unit;    // the cost's second derivative in a control, by which shifts are counted
    double augmentation;  // first weight of the end condition in the factorisation
};

// What a horizon carries from step to step beside the iterate, see RecedingHorizon.
struct HorizonMemory {
    double shift, augmentation, barrier, least_barrier, duration;
};

class RecedingHorizon {
public:
    // The programme must outlive the horizon.
    RecedingHorizon(Programme& programme, HorizonSettings settings);

    // Shifts the motion by a number of steps, which need not be whole; begins at the first entries of a state, as many
    // as are given, the others being those of the prediction; takes so many Newton steps, in so much time [s].
    HorizonStatus step(const double* state, int size, double steps, int iterations, double time_limit) noexcept;

    HorizonMemory memory() const { return {shift_, augmentation_, barrier_, least_barrier_, duration_}; }
    // Goes on from another horizon's memory, whose programme and prediction this one has been given.
    void resume(const HorizonMemory& memory) {
        shift_ = memory.shift, augmentation_ = memory.augmentation, barrier_ = memory.barrier;
        least_barrier_ = memory.least_barrier, duration_ = memory.duration;
    }

    std::size_t num_stages() const { return static_cast<std::size_t>(programme_.problem.N); }
    std::size_t state_size() const { return static_cast<std::size_t>(programme_.problem.nx); }
    std::size_t tangent_size() const { return unit_.size(); }
    std::size_t num_controls() const { return answer_.size(); }

    // Copies of the prediction: they stay where they are in memory. Gains are those of the last factorisation.
    Numbers x, u, gains;

private:
    using Clock = std::chrono::steady_clock;
    enum class Found { step, none, singular, not_finite };

    void move_on(double steps);
    void learn_duration(double seconds);
    void move_states(int whole, double part);
    void move_rows(Numbers& values, std::size_t first, int size, int whole, double part) const;
    bool has_same_rows() const;  // limits of all stages alike
    Found newton_step(HorizonStatus& status, Clock::time_point deadline);
    void begin_anew();
    void adapt_barrier(Evaluation& e);
    void copy_out();
    void copy_gains();

    Programme& programme_;
    HorizonSettings settings_;
    double shift_ = 0, augmentation_, barrier_, least_barrier_;
    double duration_ = 0;  // of a Newton step, as the last ones were [s]
    bool is_late_ = false;
    bool rows_move_;
    Numbers dx_, unit_, answer_;
};

}  // namespace mbocp
