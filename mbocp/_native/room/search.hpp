// A way between two configurations of a room: two trees that grow towards each other, and its corners cut.
#pragma once

#include <cstdint>
#include <vector>

#include "room.hpp"

namespace mbocp {

// What a search has to know beside the room.
struct SearchOptions {
    std::vector<double> low, high;            // of each number of a configuration
    std::vector<double> size;                 // how far from the line samples are
    std::vector<std::pair<int, int>> groups;  // numbers of unit length: the first, and how many
    double step;                              // of a tree, in the configuration space
    double resolution;                        // between two configurations that are looked at
    int most;                                 // steps of both trees
    std::uint64_t seed;
};

class Search {
public:
    Search(const Room& room, SearchOptions options) : room_(room), options_(std::move(options)) {
        state_ = options_.seed * 0x9E3779B97F4A7C15ULL + 1;
    }

    // Corners of a way that keeps a reserve, one after the other, both ends included; empty if none is found.
    std::vector<double> way(const double* from, const double* to, double reserve);

    // The way with corners cut as long as it keeps the reserve.
    std::vector<double> cut(std::vector<double> way, double reserve, int tries);

    // Whether the line keeps a reserve.
    bool is_free(const double* from, const double* to, double reserve);

private:
    struct Tree {
        std::vector<double> places;
        std::vector<int> parents;
    };

    const Room& room_;
    SearchOptions options_;
    Placed placed_;
    std::uint64_t state_;
    std::vector<double> between_, target_, nearest_;
    std::size_t hit_ = 0;  // cluster of what was touched last

    double uniform();  // in [0, 1)
    void interpolate(const double* from, const double* to, double share, double* found) const;
    double length(const double* from, const double* to) const;
    bool is_clear(const double* q, double reserve);
    void sample(const double* from, const double* to, double* found);
    int grow(Tree& tree, const double* target, double reserve, bool& is_there);
    void append(const Tree& tree, int place, bool is_reversed, std::vector<double>& way) const;
};

}  // namespace mbocp
