// The flow of a robot under the controls of steps, by an explicit Runge-Kutta method: flows of many steps side by side,
// each from its own state, or one through all of them.
#pragma once

#include "pool.hpp"
#include "stage_function.hpp"

namespace mbocp {

// Row i of `slopes` weighs the slopes before stage i, which is at the share nodes[i] of a step.
struct Tableau {
    std::vector<Numbers> slopes;
    Numbers weights, nodes;
};

// Steps of a problem, one after another: coefficients of 1, s, s^2, ... of the controls in the share s of a step that
// has passed, a block for each, and the length of the step [s].
struct FlowSteps {
    const double *controls, *lengths;
    int count, size;  // of coefficients in each
};

// At the begin of each step its coefficients change by gains times what the state is away from the planned one, and,
// where the gains have columns for that, by what the control at the end of the step before was.
struct FlowFeedback {
    StageFunction* difference;  // (q, q, numbers) -> tangent
    const double *planned, *gains;
    int width;  // columns of the gains
};

class Flow {
public:
    // rate (q, s, u, numbers) -> dq/dt, ds/dt; `numbers` may be none, where the function has no such input.
    Flow(Function rate, Numbers numbers, Tableau tableau);

    int state_size() const { return nq_ + ns_; }
    int num_controls() const { return nu_; }
    const Numbers& numbers() const { return numbers_; }

    // States after each step from its own, in so many parts; what is not finite comes back as such.
    Numbers ends(const double* states, const FlowSteps& steps, int parts);
    // States of the nodes of one flow that begins in `state`; `carried` is what the control is away from its plan.
    Numbers chain(const double* state, const FlowSteps& steps, int parts, const FlowFeedback* feedback,
                  Numbers& carried);

private:
    void step(int lanes, int count, const double* controls, int size, const double* lengths, int part, int parts);
    void find_slopes(int lanes, int count, int stage);
    void answer(const FlowFeedback& feedback, int n, const FlowSteps& steps, Numbers& carried);

    Function rate_;
    Numbers numbers_;
    Tableau tableau_;
    int nq_, ns_, nu_;
    Pool memory_;
    double *x_, *at_, *applied_, *slopes_;  // of each lane, one after another
    Numbers answered_, away_;
};

}  // namespace mbocp
