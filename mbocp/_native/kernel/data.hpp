// The numbers of a programme at its iterate: what its functions return, and what the factorisation makes of them.
#pragma once

#include <vector>

#include "iterate.hpp"
#include "pool.hpp"
#include "results.hpp"

namespace mbocp {

// What a dense step solves with: Jw's factors; Jw = -1; those of what is left of Jw without its direct rows; those of
// its diagonal blocks E and Y, see Kind; or those of what is left without followers.
enum class StepFactors { whole, none, rest, blocks, others };

// How a stage's Quu has been factorised: definite or not, without pivoting; definite; with pivoting.
enum class ControlFactors { ldl, cholesky, lu };

// Blocks of one stage. With w = (x, y) and s = (state before, u), matrices are row-major, rows padded to whole vectors.
struct Stage {
    const Kind* kind;
    double *c, *gw, *gs, *lw, *ls;       // residual, Lagrangian gradient, cost gradient
    double* begin() const { return c; }  // of the stage's memory, all of it one block

    // Of a dense step: derivatives, and factors.
    double *Jw, *Js, *Hww, *Hws, *Hss, *LU;
    double* V;     // the response of what its followers follow, and more behind it, see followers.hpp
    double* lead;  // -A^{-1} of its direct rows' lead, A a + B z + C s, with D = -A^{-1} B and J = -A^{-1} C behind it
    int* pivot;
    StepFactors factors_of;

    // Of a step with a structure: values of the sparse derivatives; the factored step; half the Hessian Q over (xi
    // before, u) of the stage over reachable states, and g, its gradient in xi and in these; offsets, dx = B xi + b
    // with xi = dx[chosen].
    double *J, *H, *Q, *g, *b;
    int* chosen;
    StepFactor step;

    // Of the recursion: the response T of w, or of xi, to what is before; the eliminated controls with their gains; the
    // value function P and the columns S of eta at the stage's end; what one right-hand side makes of it; and H z of
    // the last forward pass.
    double *T, *Quu, *K, *Keta, *P, *S;
    double *t0, *k, *p, *Hz;
    int* control_pivot;
    ControlFactors factors;
};

// The end of the horizon at the last state.
struct End {
    Numbers H, S, g;     // Hessian, the end condition's Jacobian transposed, its value
    Numbers psi_x, r_x;  // gradients of the cost and of the Lagrangian

    explicit End(const Problem& p);
    bool evaluate(const Problem& p, const Iterate& at, Evaluation& e);
};

class Data {
public:
    explicit Data(const Problem& problem);

    Stage& operator[](int n) { return stages_[static_cast<std::size_t>(n)]; }
    const Stage& operator[](int n) const { return stages_[static_cast<std::size_t>(n)]; }
    Stage& last() { return stages_.back(); }
    std::size_t num_bytes() const { return pool_.bytes(); }  // of the stages' blocks

    // Derivatives of the Lagrangian's later part in each node's state (boundary duals), (N + 1, ndx).
    Numbers costates() const;
    // grad_u H of every stage, in the reported scaling, and
    Numbers control_gradient() const;
    // its factor from the derivative of the Lagrangian, control after control (1/dt under a uniform step).
    Numbers control_scale() const;

    End end;

private:
    const int ndx_;
    Pool pool_;
    std::vector<int> pivots_;
    std::vector<Stage> stages_;
};

// Workspace, taken from the front, each part from the boundary of a cache line on.
class Space {
public:
    explicit Space(double* at) : at_(at) {}
    double* take(int rows, int columns = 1) { return at_ += last_, last_ = (rows * columns + 7) / 8 * 8, at_; }
    double* zeros(int rows, int columns = 1) {
        take(rows, columns);
        dense::zero(at_, last_);
        return at_;
    }

private:
    double* at_;
    int last_ = 0;
};

}  // namespace mbocp
