// Unknowns of a programme, steps in them, and the right-hand sides of these, stage after stage.
#pragma once

#include "problem.hpp"

namespace mbocp {

struct Point {
    Numbers x, y, u;  // states, algebraic unknowns, controls; x has N + 1 nodes

    explicit Point(const Problem& p) : x(p.of_nodes(p.nx), 0.0), y(p.y_offset[p.N], 0.0), u(p.u_offset[p.N], 0.0) {}
};

struct Iterate : Point {
    Numbers m, eta;  // multipliers of the stages' rows and of the end condition

    explicit Iterate(const Problem& p) : Point(p), m(p.m_offset[p.N], 0.0), eta(p.ng, 0.0) {}
};

// A step in all unknowns, states in their tangent space.
struct Increment {
    Numbers dx, dy, du, dm, deta;

    explicit Increment(const Problem& p)
        : dx(p.of_nodes(p.ndx), 0.0), dy(p.y_offset[p.N], 0.0), du(p.u_offset[p.N], 0.0), dm(p.m_offset[p.N], 0.0),
          deta(p.ng, 0.0) {}

    void add(const Increment& other);
};

// The right-hand side of the linear system: a stage's rows, gradients in (x, y) and in (state before, u); the end's.
struct Residual {
    Numbers c, w, s, x_terminal, g;

    explicit Residual(const Problem& p)
        : c(p.m_offset[p.N], 0.0), w(p.m_offset[p.N], 0.0), s(p.s_offset(p.N), 0.0), x_terminal(p.ndx, 0.0),
          g(p.ng, 0.0) {}

    void add(double factor, const Residual& other);
};

}  // namespace mbocp
