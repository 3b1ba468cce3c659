// The stagewise programme: functions, sizes, parameters.
//
//   minimise    sum_n l_n(x_{n-1}, x_n, u_n) + psi(x_N)
//   subject to  c_n(x_{n-1}, x_n, y_n, u_n) = 0        multiplier m_n     (dynamics and constraints of a step)
//               g(x_N) = 0                             multiplier eta
//
// with algebraic unknowns y_n of as many entries as c_n has rows beyond the state's tangent dimension. Nothing
// here knows what a robot is. All stages have the same functions and sizes; their numbers differ.
#pragma once

#include <vector>

#include "crew.hpp"
#include "kind.hpp"

namespace mbocp {

struct Point;

// Stages at which a function is called at once; the last is repeated in the lanes that are left.
struct Group {
    int count, stage[most_lanes];
};
using Groups = std::vector<Group>;

class Problem {
public:
    // `retract` is (x, dx) -> x, `difference` its inverse, (x, x_moved) -> dx. Threads share what is done for each
    // stage by itself, where functions can be copied.
    Problem(int num_stages, Kind kind, Terminal terminal, Function retract, Function difference, int num_threads);
    Problem(const Problem&) = delete;  // stages refer to their kind
    Problem& operator=(const Problem&) = delete;

    struct Given {
        const double* at;
        std::size_t size;
    };
    // The same numbers of each as before take no new memory.
    void set_parameters(Given theta, Given rho, Given rho_terminal);
    const Kind& kind() const { return kind_; }
    bool is_structured() const { return kind_.structure != nullptr; }

    int N, nx, ndx, ng;
    int nd;  // entries of a state that value functions and gains are over
    std::vector<int> y_offset, u_offset, m_offset, r_offset;  // of the stages, and the total
    Terminal terminal;
    Numbers theta, rho_terminal;

    Crew& crew() const { return *crew_; }

    std::size_t of_nodes(int size) const { return static_cast<std::size_t>(N + 1) * static_cast<std::size_t>(size); }
    // Of a node's state, of its tangent, and of a stage's (state before, controls).
    std::size_t x_offset(int node) const { return static_cast<std::size_t>(node) * static_cast<std::size_t>(nx); }
    std::size_t dx_offset(int node) const { return static_cast<std::size_t>(node) * static_cast<std::size_t>(ndx); }
    std::size_t s_offset(int n) const { return static_cast<std::size_t>(u_offset[n]) + dx_offset(n); }

    // Calls a stage's function, with multipliers of the horizon where it takes any. False: not finite, or failed.
    bool call(StageFunction& f, int n, const Point& at, const double* multipliers = nullptr) const;
    // The same for a group of stages, in lanes, after `prepare` of the function for the loop over groups.
    Groups groups(Function Kind::* function) const;
    void prepare(StageFunction& f, bool has_multipliers) const;
    bool call(StageFunction& f, const Group& group, const Point& at, const double* multipliers = nullptr) const;
    // All nodes but the first of x_next <- x moved by alpha dx.
    bool retract_nodes(const Numbers& x, const Numbers& dx, double alpha, Numbers& x_next) const;
    // x_next <- x moved by alpha dx.
    bool retract(const double* x, const double* dx, double alpha, double* x_next) const;
    // dx <- what takes x to x_moved.
    bool difference(const double* x, const double* x_moved, double* dx) const;

private:
    Kind kind_;
    std::unique_ptr<Crew> crew_;
    Function retract_, difference_;
    Numbers rho_;
    mutable Numbers scaled_;  // alpha dx, of a node for each lane
};

}  // namespace mbocp
