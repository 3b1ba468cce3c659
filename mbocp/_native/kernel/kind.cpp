#include "kind.hpp"

#include <algorithm>
#include <map>
#include <numeric>
#include <stdexcept>
#include <string>

#include "dense.hpp"

namespace mbocp {
using dense::padded;

void Box::include(int i, int j) {
    const int first = j / dense::width * dense::width;
    if (!rows) row = i, column = first;
    const int end = std::max(row + rows, i + 1), last = std::max(column + columns, j + 1);
    row = std::min(row, i), column = std::min(column, first);
    rows = end - row, columns = last - column;
}

void check_output(const Function& f, std::size_t index, int rows, int columns, const char* what) {
    if (f->outputs.size() <= index || f->outputs[index].rows != rows || f->outputs[index].columns != columns)
        throw std::invalid_argument(std::string(what) + ": expected output " + std::to_string(index) + " of shape (" +
                                    std::to_string(rows) + ", " + std::to_string(columns) + ")");
}

namespace {

// Whether Jw has entries on its diagonal alone, as where the step's rows are F(x_before, u) - x.
bool has_diagonal(const Pattern& J, int nw) {
    int count = 0;
    for (int k = 0; k < J.nnz(); ++k) {
        if (J.column[k] >= nw) continue;
        if (J.row[k] != J.column[k]) return false;
        ++count;
    }
    return count == nw;
}

struct Direct {
    int rows, lead;
};

// Leading rows of the state with w_i and at most the entry of w_{n + i} beside it, n the number of such rows. Where
// there are none, the first few may share two blocks, over their w_i and w_{n + i}, and one over their states before.
Direct find_direct(const Pattern& J, int nw, int ndx) {
    constexpr int most_in_lead = 6, least_with_lead = 12;  // of fewer rows a factorisation of all costs less
    std::vector<std::vector<int>> rows(static_cast<std::size_t>(J.rows));
    for (int k = 0; k < J.nnz(); ++k) rows[J.row[k]].push_back(J.column[k]);
    const auto is_diagonal = [&](int i, int n) {
        const auto fits = [&](int j) { return j == i || j == n + i || j >= nw; };
        return std::count(rows[i].begin(), rows[i].end(), i) == 1 && std::all_of(rows[i].begin(), rows[i].end(), fits);
    };
    const auto is_in_lead = [&](int i, int n, int lead) {
        return std::all_of(rows[i].begin(), rows[i].end(),
                           [&](int j) { return j < lead || (n <= j && j < n + lead) || (nw <= j && j < nw + lead); });
    };
    const auto find_lead = [&](int n) {  // 0: rows are no lead and diagonal ones
        int first = n;
        while (first > 0 && is_diagonal(first - 1, n)) --first;
        for (int i = 0; i < first; ++i)
            if (!is_in_lead(i, n, first)) return 0;
        return first <= most_in_lead ? first : 0;
    };
    for (int n = std::min(nw / 2, ndx); n > 0; --n) {
        int i = 0;
        while (i < n && is_diagonal(i, n)) ++i;
        if (i == n) return {n, 0};
    }
    for (int n = ndx / 2; n >= least_with_lead; --n)
        if (const int lead = find_lead(n)) return {n, lead};
    return {0, 0};
}

// Where one of the patterns has entries.
std::vector<std::vector<bool>> entries_of(const std::vector<const Pattern*>& patterns) {
    const Pattern& any = *patterns.front();
    std::vector<std::vector<bool>> has(any.rows, std::vector<bool>(any.columns, false));
    for (const Pattern* J : patterns)
        for (int k = 0; k < J->nnz(); ++k) has[J->row[k]][J->column[k]] = true;
    return has;
}

// The form of Jw that leaves least to factorise, by both patterns that it may have.
Kind::Blocks find_blocks(const std::vector<const Pattern*>& patterns, int nw) {
    const std::vector<std::vector<bool>> has = entries_of(patterns);
    const auto knows = [&](int row, int columns) {  // any of the first ones but its own
        for (int j = 0; j < columns; ++j)
            if (j != row && has[row][j]) return true;
        return false;
    };
    const auto cube = [](long n) { return n * n * n; };
    Kind::Blocks best;
    long least = cube(nw);
    for (int upper = 1; upper <= nw; ++upper) {
        bool is_split = true;
        for (int i = upper; i < nw && is_split; ++i) is_split = !knows(i, upper);
        int plain = 0;
        while (plain < upper && has[plain][plain] && !knows(plain, upper)) ++plain;
        const long left = cube(upper - plain) + cube(nw - upper);
        if (is_split && left < least) best = {plain, upper}, least = left;
    }
    return best;
}

// Rows of the state with an entry on the diagonal that know no other follower, those of the fewest entries first.
Followers find_followers(const std::vector<const Pattern*>& patterns, int nw, int ndx) {
    constexpr int least = 16, least_part = 4;  // unknowns, and part of them, for which it is worth the while
    const std::vector<std::vector<bool>> has = entries_of(patterns);
    std::vector<int> order(static_cast<std::size_t>(ndx));
    std::iota(order.begin(), order.end(), 0);
    const auto count = [&](int i) { return std::count(has[i].begin(), has[i].begin() + nw, true); };
    std::stable_sort(order.begin(), order.end(), [&](int i, int j) { return count(i) < count(j); });
    Followers found;
    for (const int i : order) {
        const auto is_apart = [&](int j) { return !has[i][j] && !has[j][i]; };
        if (has[i][i] && std::all_of(found.a.begin(), found.a.end(), is_apart)) found.a.push_back(i);
    }
    if (nw < least || static_cast<int>(found.a.size()) * least_part < nw) return {};
    std::sort(found.a.begin(), found.a.end());
    const auto follows = [&](int i) { return std::binary_search(found.a.begin(), found.a.end(), i); };
    for (int i = 0; i < nw; ++i)
        if (!follows(i)) found.z.push_back(i);
    for (const int i : found.z) {
        if (found.runs.empty() || i != found.runs.back().first + found.runs.back().count) found.runs.push_back({i, 0});
        ++found.runs.back().count;
    }
    found.place.assign(static_cast<std::size_t>(nw), -1);
    for (const int i : found.a) {
        for (std::size_t k = 0; k < found.z.size(); ++k)
            if (has[i][found.z[k]]) found.D.push_back({i, static_cast<int>(k)});
        for (std::size_t j = nw; j < has[i].size(); ++j)
            if (has[i][j]) found.J.push_back({i, static_cast<int>(j) - nw});
        if (std::none_of(found.z.begin(), found.z.end(), [&](int row) { return has[row][i]; })) continue;
        found.place[i] = static_cast<int>(found.known.size());
        found.known.push_back(i);
    }
    return found;
}

bool is_split(const Pattern& upper, int ndx, int nw) {
    for (int k = 0; k < upper.nnz(); ++k)
        if (upper.row[k] < ndx && upper.column[k] >= ndx && upper.column[k] < nw) return false;
    return true;
}

Targets jacobian_targets(const Pattern& J, int nw, int ldw, int lds) {
    Targets targets;
    for (int k = 0; k < J.nnz(); ++k) {
        const int i = J.row[k], j = J.column[k];
        targets.push_back(j < nw ? Target{W, i * ldw + j, -1} : Target{S, i * lds + j - nw, -1});
    }
    return targets;
}

Targets gradient_targets(const Pattern& g, int nw) {
    Targets targets;
    for (int k = 0; k < g.nnz(); ++k) {
        const int i = std::max(g.row[k], g.column[k]);
        targets.push_back(i < nw ? Target{W, i, -1} : Target{S, i - nw, -1});
    }
    return targets;
}

Targets hessian_targets(const Pattern& upper, int nw, int ldw, int lds) {
    Targets targets;
    for (int k = 0; k < upper.nnz(); ++k) {
        const int i = upper.row[k], j = upper.column[k];  // i <= j
        if (j < nw)
            targets.push_back({WW, i * ldw + j, j * ldw + i});
        else if (i < nw)
            targets.push_back({WS, i * lds + j - nw, -1});
        else
            targets.push_back({SS, (i - nw) * lds + j - nw, (j - nw) * lds + i - nw});
    }
    return targets;
}

}  // namespace

void Kind::prepare() {
    check_output(values, 0, nc(), 1, "values");
    check_output(jacobian, 2, nc(), nw() + ns(), "jacobian");
    check_output(complete, 2, nc(), nw() + ns(), "complete");
    check_output(complete, 4, nw() + ns(), nw() + ns(), "complete");
    if (!groups.empty()) prepare_structure();
    const auto &all = complete->outputs, &first = jacobian->outputs;
    may_be_explicit = groups.empty() && has_diagonal(all[2], nw()) && has_diagonal(first[2], nw());
    if (groups.empty() && !may_be_explicit) {
        const Direct direct = find_direct(all[2], nw(), ndx);
        num_direct = direct.rows, lead = direct.lead;
    }
    for (int k = 0; k < all[2].nnz(); ++k) {
        const int i = all[2].row[k], j = all[2].column[k] - nw();
        if (lead <= i && i < num_direct && j >= 0 && j != i) before.push_back({i, j});
    }
    if (groups.empty() && !may_be_explicit && !num_direct) {
        blocks = find_blocks({&all[2], &first[2]}, nw());
        if (!blocks.upper) followers = find_followers({&all[2], &first[2]}, nw(), ndx);
    }
    for (int k = 0; k < all[2].nnz(); ++k) {
        const int i = all[2].row[k], j = all[2].column[k];
        if (i < blocks.plain && j >= blocks.upper && j < nw()) beyond.push_back({i, j});
    }
    has_split_hessian = ny > 0 && is_split(all[4], ndx, nw());
    find_boxes(all[4]);
    const int ldw = padded(nw()), lds = padded(ns());
    to_jacobian = jacobian_targets(all[2], nw(), ldw, lds);
    to_first_jacobian = jacobian_targets(first[2], nw(), ldw, lds);
    to_gradient = gradient_targets(all[3], nw());
    to_first_gradient = gradient_targets(first[3], nw());
    to_hessian = hessian_targets(all[4], nw(), ldw, lds);
}

void Kind::find_boxes(const Pattern& upper) {
    for (const Entry& entry : before) couples_controls = couples_controls || entry.column >= ndx;
    for (int k = 0; k < upper.nnz(); ++k) {
        const int i = upper.row[k], j = upper.column[k], s_i = i - nw(), s_j = j - nw();
        if (j < nw()) {
            for (const auto& [a, b] : {Entry{i, j}, Entry{j, i}}) (a < ndx ? of_Hww_state : of_Hww_rest).include(a, b);
        } else if (i < nw()) {
            of_Hws.include(i, s_j), couples_controls = couples_controls || s_j >= ndx;
        } else {
            for (const auto& [a, b] : {Entry{s_i, s_j}, Entry{s_j, s_i}})
                (a < ndx ? of_Hss_state : of_Hss_controls).include(a < ndx ? a : a - ndx, b);
        }
    }
}

void Kind::prepare_structure() {
    const Pattern &all = complete->outputs[2], &first = jacobian->outputs[2], &upper = complete->outputs[4];
    structure = std::make_shared<Structure>(all, ndx, ny, nu, groups);
    hessian = SymmetricRows(upper);
    const int nq = structure->nq, nr = structure->nr, before = nw(), controls = nw() + ndx;
    const auto is_y = [&](int i) { return i >= ndx && i < before; };
    for (int k = 0; k < upper.nnz(); ++k)
        if (is_y(upper.row[k]) || (is_y(upper.column[k]) && upper.row[k] >= nq))
            throw std::invalid_argument("groups: the Hessian couples algebraic unknowns with more than q");
    const auto over_state = [&](int row, int rows, int at) {
        return OverState{hessian.block(row, rows, at, nq), hessian.block(row, rows, at + nq, nq),
                         hessian.block(row, rows, at + 2 * nq, nr)};
    };
    of_x = over_state(0, ndx, 0);
    of_before_in_x = over_state(before, ndx, 0);
    of_before = over_state(before, ndx, before);
    of_u_in_x = over_state(controls, nu, 0);
    of_u_in_before = over_state(controls, nu, before);
    of_u = hessian.block(controls, nu, controls, nu);
    of_y_in_q = hessian.block(ndx, ny, 0, nq);
    std::map<std::pair<int, int>, int> place;
    for (int k = 0; k < all.nnz(); ++k) place[{all.row[k], all.column[k]}] = k;
    for (int k = 0; k < first.nnz(); ++k) {
        const auto found = place.find({first.row[k], first.column[k]});
        if (found == place.end()) throw std::invalid_argument("jacobian: a nonzero that complete does not have");
        first_place.push_back(found->second);
    }
}

}  // namespace mbocp
