// How a stage looks, and how the end: functions and sizes.
#pragma once

#include <memory>
#include <vector>

#include "stage_function.hpp"
#include "structure.hpp"

namespace mbocp {

// Throws unless output `index` of a function has this shape.
void check_output(const Function& f, std::size_t index, int rows, int columns, const char* what);

// Where a nonzero of a function's output belongs: in a stage's unknowns w = (x1, y) or in s = (x0, u), or in a block
// over these.
enum Part { W, S };
enum Block { WW, WS, SS };

// Rows and columns beyond which a block has no entries; the first column is that of a whole vector.
struct Box {
    int row = 0, column = 0, rows = 0, columns = 0;

    void include(int i, int j);
};

struct Target {
    int block, offset, mirror;  // mirror: second place of a symmetric entry, or -1
};
using Targets = std::vector<Target>;

struct Entry {
    int row, column;
};

// Unknowns a of the state that follow from the others z and from s by the pattern, see followers.hpp.
struct Followers {
    std::vector<int> a, z;    // in rising order
    std::vector<Entry> D, J;  // rows among all unknowns; columns of D among z
    std::vector<int> known;   // of a, by rows of z
    std::vector<int> place;   // of each unknown among these, or -1
    struct Run {
        int first, count;
    };
    std::vector<Run> runs;  // of z

    bool empty() const { return a.empty(); }
};

// Functions of (x0, x1, y, u, [m,] theta, rho).
struct Kind {
    int nx = 0, ndx = 0, ny = 0, nu = 0, nr = 0;  // state, its tangent, algebraic unknowns, controls, stage parameters
    Function values;                              // -> c, l
    Function jacobian;                            // -> c, l, dc_dz, dl_dz, with z = (x1, y, x0, u)
    Function complete;                            // -> c, l, dc_dz, dl_dz, upper Hessian of l + m'c
    // Factors from the programme's rows, unknowns, multipliers and control gradient to the reported ones.
    Numbers scale_c, scale_y, scale_m, scale_ru;
    Numbers turning;  // angles of the states' tangent, see StageKind of programme/stagewise.py; none where it is empty

    bool may_be_explicit = false;  // by the pattern of Jw

    // The first unknowns, w_i = d_i w_{num_direct + i} + J_i s for i < num_direct, as far as the pattern says so: the
    // rows of a step that only add up speeds. `before` has the entries of J off its diagonal.
    int num_direct = 0;
    std::vector<Entry> before;
    // The first of them whose d and J are one block for all, as those of a floating base; they need not have -1 before
    // w_i, but any regular block.
    int lead = 0;

    // Jw = [D 0 B; A E C; 0 0 Y] by its pattern, where the diagonal D has `plain` rows and Y those from `upper` on, as
    // where a step's stages are solved for by themselves; `upper` is 0 where there is no such form. `beyond` has the
    // entries of B.
    struct Blocks {
        int plain = 0, upper = 0;
    };
    Blocks blocks;
    std::vector<Entry> beyond;
    Followers followers;             // where there are neither direct rows nor blocks
    bool has_split_hessian = false;  // no entry of Hww couples the state with the algebraic unknowns
    bool couples_controls = false;   // Hws has entries in the controls' columns, or w_i does above
    // Of a dense step: where Hww has entries in the state's and in the algebraic unknowns' rows, Hws in any, and Hss in
    // the state's and in the controls' rows.
    Box of_Hww_state, of_Hww_rest, of_Hws, of_Hss_state, of_Hss_controls;

    int nw() const { return ndx + ny; }
    int ns() const { return ndx + nu; }
    int nc() const { return ndx + ny; }

    // Direct rows, as many as others, of a state twice as long and nothing else, as a robot's steps have; or 0.
    int joints() const { return ny == 0 && ndx == 2 * num_direct ? num_direct : 0; }

    Targets to_jacobian, to_hessian, to_gradient;  // of `complete`
    Targets to_first_jacobian, to_first_gradient;  // of `jacobian`

    // Groups of constraint rows, or none; with them the stage's derivatives stay sparse (see structure.hpp).
    std::vector<GroupOfRows> groups;
    std::shared_ptr<const Structure> structure;
    SymmetricRows hessian;  // over z, and blocks of its half: rows in x, in the state before, in u and y
    OverState of_x, of_before_in_x, of_before, of_u_in_x, of_u_in_before;
    Panels of_u, of_y_in_q;
    std::vector<int> first_place;  // of the nonzeros of `jacobian` among those of `complete`

    void prepare();  // scatter tables from the functions' patterns

private:
    void find_boxes(const Pattern& upper);
    void prepare_structure();
};

struct Terminal {
    int ng = 0, nr = 0;
    Function values;    // (x, rho) -> psi, g
    Function complete;  // (x, eta, rho) -> psi, g, dg_dx, dpsi_dx, upper Hessian of psi + eta'g
};

}  // namespace mbocp
