// The stagewise programme and one Newton step of it.
//
//   minimise    sum_n l_n(x_{n-1}, x_n, u_n) + psi(x_N)
//   subject to  c_n(x_{n-1}, x_n, y_n, u_n) = 0        multiplier m_n     (dynamics and constraints of a step)
//               g(x_N) = 0                             multiplier eta
//
// with algebraic unknowns y_n of as many entries as c_n has rows beyond the state's tangent dimension. Nothing
// here knows what a robot is. Stages refer to a kind (functions and dimensions); kinds may differ along the horizon.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "dense.hpp"
#include "limits.hpp"
#include "pool.hpp"
#include "stage_function.hpp"
#include "structure.hpp"

namespace mbocp {

// Blocks of a stage that a function's nonzeros are scattered into.
enum Block { JW, JS, HWW, HWS, HSS, GW, GS };

// How one kind of stage looks: functions of (x0, x1, y, u, [m,] theta, rho).
struct Kind {
    int nx = 0, ndx = 0, ny = 0, nu = 0, nr = 0;  // state, its tangent, algebraic unknowns, controls, stage parameters
    Function values;                              // -> c, l
    Function jacobian;                            // -> c, l, dc_dz, dl_dz, with z = (x1, y, x0, u)
    Function complete;                            // -> c, l, dc_dz, dl_dz, upper Hessian of l + m'c
    // Factors from the programme's rows, unknowns, multipliers and control gradient to the reported ones.
    Numbers scale_c, scale_y, scale_m, scale_ru;

    bool may_be_explicit = false;  // by the pattern of Jw

    int nw() const { return ndx + ny; }
    int ns() const { return ndx + nu; }
    int nc() const { return ndx + ny; }

    struct Target {
        int block, offset, mirror;  // mirror: second place of a symmetric entry, or -1
    };
    std::vector<Target> to_jacobian, to_hessian, to_gradient;  // of `complete`
    std::vector<Target> to_first_jacobian, to_first_gradient;  // of `jacobian`

    // Groups of constraint rows, or none; with them the stage's derivatives stay sparse (see structure.hpp).
    std::vector<GroupOfRows> groups;
    std::shared_ptr<const Structure> structure;
    SymmetricRows hessian;  // over z, and blocks of its half: rows in x, in the state before, in u and y
    OverState of_x, of_before_in_x, of_before, of_u_in_x, of_u_in_before;
    Panels of_u, of_y_in_q;
    std::vector<int> first_place;  // of the nonzeros of `jacobian` among those of `complete`

    void prepare();  // scatter tables from the functions' patterns

private:
    void prepare_structure();
};

struct Terminal {
    int ng = 0, nr = 0;
    Function values;    // (x, rho) -> psi, g
    Function complete;  // (x, eta, rho) -> psi, g, dg_dx, dpsi_dx, upper Hessian of psi + eta'g
};

struct Evaluation {
    double cost = 0, residual = 0, primal = 0, dual = 0, violation = 0, worst = 0;
    int worst_stage = -1, worst_row = -1;  // stage -1: the end condition; rows beyond a stage's own: its limits
    bool finite = false;
    // With limits: the cost with its barrier, which the line search looks at; the largest defect of the optimality
    // conditions of the barrier problem; the norm of multipliers times distances, which `dual` contains.
    double objective = 0, barrier_error = 0, complementarity = 0;
};

struct Factorisation {
    int negative = 0;             // negative eigenvalues of the control Hessians plus those of eta's Schur complement
    double smallest_pivot = 0.0;  // relative, over the stages' step matrices
    double end_condition = 1.0;   // relative size of the smallest eigenvalue of eta's (equilibrated) Schur complement
    bool ok = false;
    int bad_stage = -1;  // where a matrix was singular; num_stages: the end condition
};

struct Direction {
    double increment = 0, slope = 0, curvature = 0, linear_residual = 0;  // slope of the objective
    double longest = 1, longest_dual = 1;  // steps that keep slacks and limits' multipliers positive
    bool finite = false;
};

struct Trial {
    double objective = 0, violation = 0;
    bool finite = false;
};

struct Sweep {
    bool ok = false;
    int failed_stage = -1, iterations = 0;
    double residual = 0;
};

class Programme {
public:
    // `retract` is (x, dx) -> x, `difference` its inverse, (x, x_moved) -> dx.
    Programme(std::vector<Kind> kinds, std::vector<int> stage_kind, Terminal terminal, Function retract,
              Function difference);

    int num_stages() const { return N; }
    std::size_t num_bytes() const { return pool_.bytes(); }  // of the stages' blocks
    void set_parameters(const Numbers& theta, const Numbers& rho, const Numbers& rho_terminal);

    Numbers x, y, u, m, eta;  // the iterate: (N+1) nx, then stage after stage

    // Limits, see limits.hpp; states are plain vectors then (nx = ndx). With a structure only controls can have any.
    void set_limits(const Bounds& bounds, Function path, Function guard);
    // Slacks at the values of the iterate, moved inside by a part of their bounds and of the gap between them, and
    // multipliers that suit the barrier parameter.
    void start_limits(double barrier, double inside);
    // Another barrier parameter at the iterate of the last evaluation.
    Evaluation weigh(double barrier);
    int num_limits() const { return limits_.total; }
    // Multipliers of the limits, positive where an upper one is active: rows of the stages, then guards.
    Numbers limit_multipliers() const;
    Numbers slack, z_lower, z_upper;  // part of the iterate

    // Functions and derivatives at the iterate; the Hessian uses multipliers scaled by `share` (0: Gauss-Newton).
    Evaluation evaluate(double share);
    // `shift` is added to the Hessian's diagonal in every state, `augment` weighs the end condition (see riccati.cpp).
    Factorisation factorise(double shift, double augment);
    Direction solve(int refinements);
    // Second-order correction: the direction for constraint values alpha c + c(trial).
    Direction correct(double alpha);
    // The iterate moved along the direction, into a second buffer; `trial` also evaluates cost and violation there.
    bool move(double alpha);
    Trial trial(double alpha);
    // Take the moved iterate over; multipliers go alpha of their way, those of limits alpha_limits.
    void accept(double alpha, double alpha_limits);
    // States and algebraic unknowns from x[0] and u, stage by stage (eq. 29). A warm sweep starts each step from the
    // iterate, a cold one from the state before. With `feedback` the controls answer deviations from the iterate's
    // states with the gains of the last factorisation, which keeps a sweep of an unstable system near them.
    Sweep simulate(double tolerance, int max_iterations, bool warm, bool feedback);
    // Cost, first derivatives, and multipliers from eta by the backward sweep (eq. 30), or by that of the auxiliary
    // adjoint, m = sigma + A eta (eqs. 42-44). The residual is r_u (eq. 31): end condition and control gradients. With
    // `feedback` it is the adjoint of the sweep in closed loop, u + K (x - x_planned); the two agree where r_u
    // vanishes.
    Evaluation gradient(bool auxiliary, bool feedback);
    // Derivative of the end condition in all controls after a `gradient`, (ng, nu_total); likewise.
    Numbers end_sensitivity(bool feedback);
    // Hessian of the reduced problem in (eta, u) at the last `evaluate`, with `shift` on every state's diagonal: dense,
    // symmetric, (ng + nu_total)^2 entries. Quadratic work in the number of stages: the reference for `factorise`.
    Numbers reduced_hessian(double shift);

    struct Step {
        Numbers dx, dy, du, dm, deta;
    };
    const Step& direction() const { return step_; }
    // Derivatives of the Lagrangian's later part in each node's state (boundary duals), (N + 1, ndx).
    Numbers costates() const;
    // grad_u H of every stage, in the reported scaling.
    Numbers control_gradient() const;
    // Its factor from the derivative of the Lagrangian, control after control (1/dt under a uniform step).
    Numbers control_scale() const;
    const Numbers& end_condition() const { return gterm_; }
    // The auxiliary adjoint of the last `gradient(true)`: sigma, and A with ng columns, both for the rows of the
    // dynamics, stage after stage.
    Numbers sigma, A;
    std::vector<int> y_offset, u_offset, m_offset, r_offset;

private:
    struct Stage {
        const Kind* kind;
        double *c, *gw, *gs, *lw, *ls;            // residual, Lagrangian gradient, cost gradient
        double *Jw, *Js, *Hww, *Hws, *Hss;        // derivatives
        double *LU, *T, *Quu, *K, *Keta, *P, *S;  // factorisation
        double *t0, *k, *p;                       // one right-hand side
        int *pivot, *control_pivot;
        bool definite, is_explicit;  // the latter: Jw = -1
        // With a structure: values of the sparse derivatives; the stage over reachable states alone, which is
        // xi = T (xi before, u) and half the Hessian Q in (xi before, u), and g, its gradient in xi and in these;
        // offsets, dx = B xi + b with xi = dx[chosen]; and H z of the last forward pass.
        double *J, *H, *Q, *g, *b, *Hz;
        int* chosen;
        StepFactor step;
    };
    struct Residual {  // right-hand side of the linear system, stage after stage
        Numbers c, w, s, x_terminal, g;
    };

    void bind(StageFunction& f, int n, const Numbers& x_now, const Numbers& y_now, const Numbers& u_now) const;
    bool evaluate_stage(int n, const double* multipliers, Evaluation& e);
    bool evaluate_terminal(Evaluation& e);
    bool evaluate_first(int n, Evaluation& e);
    bool adjoint_stage(int n, const double* after, bool auxiliary);
    bool auxiliary_stage(int n, double* now);
    void copy_state_jacobian(int n, double* F, int ld) const;
    void feed_back(int n, const double* dx, double* du) const;
    void close_loop(int n, const double* du, double* dx) const;
    bool simulate_stage(int n, double tolerance, int max_iterations, bool warm, Sweep& sweep);
    double stationarity(double& largest) const;
    void allocate();
    std::size_t reduced_space(const Kind& k) const;
    bool condense(int n, Factorisation& result);
    // What condensing ends with: controls eliminated from the quadratic form q(i, j) over (state before, controls) and
    // its columns QS of eta, the remainder to the stage before. `kept` is workspace of nu rows.
    template <class Quadratic>
    bool eliminate_controls(int n, Quadratic q, const double* QS, double* kept, Factorisation& result);
    void solve_controls(const Stage& s, double* k) const;
    // A stage's derivatives and its step, dense or sparse. z = (w, s) = (x, y; x_before, u).
    void add_jacobian(int n, const double* dw, const double* ds, double* c) const;
    void add_jacobian_transposed(int n, const double* dm, double* w, double* s) const;
    void add_hessian(int n, const double* dw, const double* ds, double* w, double* s);
    double factor_step(int n);
    bool is_minus_identity(int n) const;
    double factor_step_of(int n, const StageFunction& jacobian);
    void store_first_jacobian(int n, const StageFunction& jacobian);
    void solve_step(int n, double* c);
    void solve_steps(int n, double* C, int ldc);
    void solve_step_transposed(int n, double* w);
    // The same for stages with a structure, in reduced.cpp.
    const StepFactor* step_before(int n) const { return n > 0 ? &stages_[n - 1].step : nullptr; }
    bool reduce_stages(Factorisation& result);
    bool reduce(int n, Factorisation& result);
    void reduce_hessian(int n);
    void reduce_residual(int n, const Residual& rhs);
    bool condense_reduced(int n, Factorisation& result);
    void reduce_end();
    void backward_start_reduced(const Residual& rhs, Numbers& r);
    void backward_stage_reduced(int n, Numbers& r);
    void forward_reduced(const Residual& rhs, Step& out);
    void multipliers_reduced(const Residual& rhs, Step& out);
    struct Check {  // rhs + KKT d, its largest entry, and d'Hd
        Residual& left;
        double largest = 0, curvature = 0;
        bool knows_products = false;  // H d, shift included, is what a stage's Hz holds
    };
    void backward_start(const Residual& rhs, Numbers& r);
    void backward_stage(int n, const Residual& rhs, Numbers& r);
    void backward(const Residual& rhs, Numbers& r);
    void forward(const Residual& rhs, const Numbers& r, Step& out, Check* check);
    void check_stage(int n, const Residual& rhs, const Step& d, Check& check);
    void check_end(const Residual& rhs, const Step& d, Check& check);
    void gather_residual(Residual& out) const;
    Direction finish_direction(const Residual& rhs, int refinements);
    // Limits, in limits.cpp.
    bool evaluate_limits();
    bool evaluate_path(int n, const Numbers& x_now, double* h, double* J, double* H);
    bool evaluate_guard(const Numbers& x_now, double* h, double* J, double* H);
    void add_limit_gradients(Residual& out) const;
    void add_limits_to_value(int n);
    void add_limit_products(int n, const double* dx, const double* du, double* Hx, double* Hu) const;
    void find_limit_step(Direction& d);
    bool try_limits(Trial& t);
    void accept_limits(double alpha);
    void finish_evaluation(Evaluation& e) const;
    bool retract_into(const double* x_now, const double* dx, double alpha, double* x_next);

    Limits limits_;
    Evaluation last_;  // the last evaluation without what depends on the barrier parameter
    std::vector<Kind> kinds_;
    std::vector<int> stage_kind_;
    Terminal terminal_;
    Function retract_, difference_;
    int N, nx_, ndx_, ng_;
    int nd_ = 0;  // entries of a state that value functions and gains are over: all, or the chosen ones
    bool is_structured_ = false;
    bool steps_known_ = false;     // stages are reduced as of the last evaluation, whatever the shift, and
    bool residual_known_ = false;  // so are their gradients
    double step_pivot_ = 1.0;      // smallest pivot of these
    Numbers theta_, rho_, rho_terminal_;
    Pool pool_;
    std::vector<int> pivots_;
    std::vector<Stage> stages_;
    Numbers Hterm_, Sterm_, gterm_, psix_, rterm_;  // terminal Hessian, Jacobian transposed, g, gradients
    Numbers R_, R_factor_;                          // Schur complement of eta
    std::vector<int> R_pivot_;
    Step step_;
    Residual rhs_, work_;
    Step correction_;
    Numbers x_trial_, y_trial_, u_trial_;
    Numbers c_trial_, g_trial_, zeros_;
    Numbers scaled_m_, diagonal_;
    double shift_ = 0, augment_ = 0;                   // of the last factorisation
    bool factorised_ = false, backward_done_ = false;  // the latter: for the residual of the last evaluation
    Numbers eta_rhs_;
    Numbers sweep_c_, sweep_dx_, sweep_before_, planned_;  // workspace of the sweeps
    Numbers auxiliary_S_;                                  // of the auxiliary adjoint: what A_n leaves at x_n
    Pool scratch_, space_;                                 // workspace; the latter of stages with a structure
    Numbers both_;
    int max_nw_ = 0, max_ns_ = 0;
};

}  // namespace mbocp
