#include "search.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace mbocp {

// SplitMix64: the same numbers on every machine.
double Search::uniform() {
    std::uint64_t z = (state_ += 0x9E3779B97F4A7C15ULL);
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ULL;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBULL;
    return static_cast<double>((z ^ (z >> 31)) >> 11) * 0x1.0p-53;
}

// Linear in the numbers; of unit length again where they have to be, which is the shortest way on the circle or sphere.
void Search::interpolate(const double* from, const double* to, double share, double* found) const {
    for (int i = 0; i < room_.nq; ++i) found[i] = from[i] + share * (to[i] - from[i]);
    for (const auto& [first, count] : options_.groups) {
        double product = 0.0, square = 0.0;
        for (int i = first; i < first + count; ++i) product += from[i] * to[i];
        const double sign = count == 4 && product < 0.0 ? -1.0 : 1.0;  // a quaternion and its negative are one
        for (int i = first; i < first + count; ++i) {
            found[i] = from[i] + share * (sign * to[i] - from[i]);
            square += found[i] * found[i];
        }
        for (int i = first; i < first + count; ++i) found[i] = square > 1e-12 ? found[i] / std::sqrt(square) : from[i];
    }
}

double Search::length(const double* from, const double* to) const {
    double square = 0.0;
    for (int i = 0; i < room_.nq; ++i) square += (to[i] - from[i]) * (to[i] - from[i]);
    return std::sqrt(square);
}

bool Search::is_clear(const double* q, double reserve) {
    room_.place(q, placed_);
    for (std::size_t k = 0; k < room_.clusters.size(); ++k) {
        const std::size_t turn = k == 0 ? hit_ : k == hit_ ? 0 : k;  // what was touched last is touched most often
        if (room_.least(room_.clusters[turn], placed_, reserve) < reserve) {
            hit_ = turn;
            return false;
        }
    }
    return true;
}

// The end of the line first, then its middle, and then between these: what is not free is found early.
bool Search::is_free(const double* from, const double* to, double reserve) {
    between_.resize(static_cast<std::size_t>(room_.nq));
    const double pieces = std::ceil(length(from, to) / options_.resolution);
    int count = 1;
    while (count < pieces) count *= 2;
    if (!is_clear(to, reserve)) return false;
    for (int width = count; width > 1; width /= 2) {
        for (int k = width / 2; k < count; k += width) {
            interpolate(from, to, static_cast<double>(k) / count, between_.data());
            if (!is_clear(between_.data(), reserve)) return false;
        }
    }
    return true;
}

void Search::sample(const double* from, const double* to, double* found) {
    interpolate(from, to, uniform(), found);
    for (int i = 0; i < room_.nq; ++i) {
        found[i] += (2.0 * uniform() - 1.0) * options_.size[i];
        found[i] = std::min(std::max(found[i], options_.low[i]), options_.high[i]);
    }
    for (const auto& [first, count] : options_.groups) {
        double square = 0.0;
        for (int i = first; i < first + count; ++i) square += found[i] * found[i];
        for (int i = first; i < first + count; ++i) found[i] = square > 1e-12 ? found[i] / std::sqrt(square) : from[i];
    }
}

// One step from the nearest place towards a target; -1 where it is not free.
int Search::grow(Tree& tree, const double* target, double reserve, bool& is_there) {
    const int nq = room_.nq, count = static_cast<int>(tree.parents.size());
    int nearest = 0;
    double best = 1e300;
    for (int k = 0; k < count; ++k) {
        const double* place = tree.places.data() + static_cast<std::size_t>(k) * nq;
        double square = 0.0;
        for (int i = 0; i < nq; ++i) square += (place[i] - target[i]) * (place[i] - target[i]);
        if (square < best) best = square, nearest = k;
    }
    const double* place = tree.places.data() + static_cast<std::size_t>(nearest) * nq;
    nearest_.assign(place, place + nq);
    const double away = std::sqrt(best);
    std::vector<double> there(target, target + nq);
    is_there = away <= options_.step;
    if (!is_there) interpolate(nearest_.data(), target, options_.step / away, there.data());
    if (!is_free(nearest_.data(), there.data(), reserve)) return -1;
    tree.places.insert(tree.places.end(), there.begin(), there.end());
    tree.parents.push_back(nearest);
    return count;
}

void Search::append(const Tree& tree, int place, bool is_reversed, std::vector<double>& way) const {
    std::vector<int> chain;
    for (int k = place; k >= 0; k = tree.parents[static_cast<std::size_t>(k)]) chain.push_back(k);
    if (!is_reversed) std::reverse(chain.begin(), chain.end());
    for (int k : chain) {
        const auto first = tree.places.begin() + static_cast<std::ptrdiff_t>(k) * room_.nq;
        way.insert(way.end(), first, first + room_.nq);
    }
}

std::vector<double> Search::way(const double* from, const double* to, double reserve) {
    const int nq = room_.nq;
    Tree trees[2] = {{{from, from + nq}, {-1}}, {{to, to + nq}, {-1}}};
    std::vector<double> target(static_cast<std::size_t>(nq));
    int steps = 0;
    for (int turn = 0; steps < options_.most; ++turn) {
        Tree &mine = trees[turn % 2], &other = trees[1 - turn % 2];
        bool is_there = false;
        sample(from, to, target.data());
        const int added = grow(mine, target.data(), reserve, is_there);
        ++steps;
        if (added < 0) continue;
        const auto first = mine.places.begin() + static_cast<std::ptrdiff_t>(added) * nq;
        std::copy(first, first + nq, target.begin());
        while (steps++ < options_.most) {
            const int reached = grow(other, target.data(), reserve, is_there);
            if (reached < 0) break;
            if (!is_there) continue;
            std::vector<double> found;
            // The place where they meet is in both trees.
            const bool is_turned = turn % 2 == 1;
            const int last = is_turned ? reached : added;
            const int next = is_turned ? mine.parents[static_cast<std::size_t>(added)]
                                       : other.parents[static_cast<std::size_t>(reached)];
            append(trees[0], last, false, found);
            append(trees[1], next, true, found);
            return found;
        }
    }
    return {};
}

std::vector<double> Search::cut(std::vector<double> way, double reserve, int tries) {
    const int nq = room_.nq;
    for (int k = 0; k < tries; ++k) {
        const int count = static_cast<int>(way.size()) / nq;
        if (count < 3) break;
        int a = static_cast<int>(uniform() * count), b = static_cast<int>(uniform() * count);
        if (a > b) std::swap(a, b);
        if (b - a < 2 || !is_free(way.data() + a * nq, way.data() + b * nq, reserve)) continue;
        way.erase(way.begin() + (a + 1) * nq, way.begin() + b * nq);
    }
    return way;
}

}  // namespace mbocp
