// The passes of a tape, compiled for one kind of processor: vectors of MBOCP_WIDTH numbers. Nothing in here is shared
// with other files, as what these have for another kind would take its place.
#include <cmath>
#include <cstring>
#include <limits>
#include <type_traits>

#include "passes.hpp"

// Sine and cosine of several numbers at once, as generated C has them.
#define MBOCP_LANES MBOCP_WIDTH
#include "../../programme/lanes.h"

namespace mbocp {
namespace {

typedef double mbocp_vector __attribute__((vector_size(8 * MBOCP_WIDTH), aligned(8), may_alias));

inline mbocp_vector load(const double* p) { return *reinterpret_cast<const mbocp_vector*>(p); }
inline double multiply_add(double x, double y, double z) { return mbocp_one_multiply_add(x, y, z); }
inline mbocp_vector multiply_add(mbocp_vector x, mbocp_vector y, mbocp_vector z) {
#if MBOCP_LANES == MBOCP_WIDTH
    return mbocp_multiply_add(x, y, z);
#else
    return x * y + z;
#endif
}
inline void store(double* p, mbocp_vector v) { *reinterpret_cast<mbocp_vector*>(p) = v; }

template <class Sine>
void apply(const double* x, double* f, int n, Sine function) {
    constexpr int width = sizeof(mbocp_lanes) / sizeof(double);
    mbocp_lanes v;
    for (; n >= width; n -= width, x += width, f += width) {
        std::memcpy(&v, x, sizeof v);
        v = function(v);
        std::memcpy(f, &v, sizeof v);
    }
}

struct One {
    using Vec = double;
};
struct Wide {
    using Vec = mbocp_vector;
};

// Whether a number is that of every lane, as numbers that choose are as a rule.
bool all_are(const double* numbers, int n) {
    bool same = true;
    for (int k = 1; k < n; ++k) same &= numbers[k] == numbers[0];
    return same;
}

// The place in a list that a number chooses; null beyond its ends.
template <class At>
double* chosen(const std::int32_t* list, double number, At at) {
    return number >= 0.0 && number < *list ? at(list[1 + static_cast<std::int32_t>(number)]) : nullptr;
}

bool is_any(const double* numbers, int n) {
    bool any = false;
    for (int k = 0; k < n; ++k) any |= numbers[k] != 0.0;
    return any;
}

// All instructions for `Blocks` vectors of each place; one number, where Blocks is 0.
template <int Blocks>
void pass_over(const Passes& tape, double* memory, int stride) {
    using Vec = typename std::conditional_t<Blocks == 0, One, Wide>::Vec;
    constexpr int count = Blocks > 0 ? Blocks : 1, width = sizeof(Vec) / sizeof(double);
    const auto at = [=](std::int32_t place) { return memory + static_cast<std::size_t>(place) * stride; };
    const Instruction *i = tape.code, *end = i;
    for (int number = 0; number < tape.num_runs; ++number) {
        end += tape.runs[number];
        // All of a run: what it does with the places of its instructions.
        const auto run = [&](auto work) {
            for (; i != end; ++i) work(*i, at(i->to), at(i->a), at(i->b));
        };
        const auto each = [&](auto value) {
            run([&](const Instruction& j, double* to, const double* a, const double* b) {
                for (int k = 0; k < count; ++k) {
                    if constexpr (Blocks == 0)
                        to[0] = value(a[0], b[0], [&] { return at(j.c)[0]; });
                    else
                        store(to + k * width, value(load(a + k * width), load(b + k * width),
                                                    [&] { return load(at(j.c) + k * width); }));
                }
            });
        };
        const auto each_lane = [&](auto value) {
            run([&](const Instruction&, double* to, const double* a, const double* b) {
                for (int k = 0; k < count * width; ++k) to[k] = value(a[k], b[k]);
            });
        };
        const auto truth = [&](auto compare) {
            each_lane([&](double x, double y) { return compare(x, y) ? 1.0 : 0.0; });
        };
        switch (i->operation) {
        case Operation::copy:
            each([](Vec x, Vec, auto) { return x; });
            break;
        case Operation::negate:
            each([](Vec x, Vec, auto) { return -x; });
            break;
        case Operation::add:
            each([](Vec x, Vec y, auto) { return x + y; });
            break;
        case Operation::subtract:
            each([](Vec x, Vec y, auto) { return x - y; });
            break;
        case Operation::multiply:
            each([](Vec x, Vec y, auto) { return x * y; });
            break;
        case Operation::divide:
            each([](Vec x, Vec y, auto) { return x / y; });
            break;
        case Operation::invert:
            each([](Vec x, Vec, auto) { return 1.0 / x; });
            break;
        case Operation::multiply_add:
            each([](Vec x, Vec y, auto z) { return multiply_add(x, y, z()); });
            break;
        case Operation::multiply_subtract:
            each([](Vec x, Vec y, auto z) { return multiply_add(x, y, -z()); });
            break;
        case Operation::subtract_product:
            each([](Vec x, Vec y, auto z) { return multiply_add(-x, y, z()); });
            break;
        case Operation::square_root:
            each_lane([](double x, double) { return std::sqrt(x); });
            break;
        case Operation::absolute:
            each_lane([](double x, double) { return std::abs(x); });
            break;
        case Operation::sine:
            run([&](const Instruction&, double* to, const double* a, const double*) {
                if constexpr (Blocks == 0)
                    to[0] = mbocp_first(mbocp_sin(mbocp_all(a[0])));
                else
                    apply(a, to, count * width, [](mbocp_lanes x) { return mbocp_sin(x); });
            });
            break;
        case Operation::cosine:
            run([&](const Instruction&, double* to, const double* a, const double*) {
                if constexpr (Blocks == 0)
                    to[0] = mbocp_first(mbocp_cos(mbocp_all(a[0])));
                else
                    apply(a, to, count * width, [](mbocp_lanes x) { return mbocp_cos(x); });
            });
            break;
        case Operation::less:
            truth([](double x, double y) { return x < y; });
            break;
        case Operation::at_most:
            truth([](double x, double y) { return x <= y; });
            break;
        case Operation::equal:
            truth([](double x, double y) { return x == y; });
            break;
        case Operation::unequal:
            truth([](double x, double y) { return x != y; });
            break;
        case Operation::is_false:
            truth([](double x, double) { return x == 0.0; });
            break;
        case Operation::where:
            each_lane([](double x, double y) { return x != 0.0 ? y : 0.0; });
            break;
        case Operation::choose:
            run([&](const Instruction& j, double* to, const double* a, const double*) {
                for (int k = 0; k < count * width; ++k) {
                    const double* from = chosen(tape.lists + j.b, a[k], at);
                    if (from && all_are(a, count * width)) {
                        std::memcpy(to, from, sizeof(double) * count * width);
                        break;
                    }
                    to[k] = from ? from[k] : std::numeric_limits<double>::quiet_NaN();
                }
            });
            break;
        case Operation::add_chosen:
            run([&](const Instruction& j, double*, const double* a, const double*) {
                for (int k = 0; k < count * width; ++k)
                    if (double* sum = chosen(tape.lists + j.b, a[k], at)) sum[k] += at(j.c)[k];
            });
            break;
        case Operation::skip_unless_any: {
            const auto is_needed = [&](int k) { return is_any(at(i->a) + k * width, width); };
            int num_needed = 0;
            for (int k = 0; k < count; ++k) num_needed += is_needed(k);
            if (2 * num_needed > count) {  // all at once takes no longer
                i = end;
                break;
            }
            const Passes part{i + 1, tape.runs + number + 1, i->to, tape.lists, tape.other};
            const std::int32_t* places = tape.lists + i->b;
            for (int k = 0; k < count; ++k) {
                if (is_needed(k)) {
                    pass_over<1>(part, memory + k * width, stride);
                    continue;
                }
                for (int p = 1; p <= *places; ++p) std::memset(at(places[p]) + k * width, 0, sizeof(double) * width);
            }
            number += i->to, end += i->c, i = end;
            break;
        }
        case Operation::other:
            run([&](const Instruction& j, double* to, const double* a, const double* b) {
                tape.other(j.c, a, b, to, count * width);
            });
            break;
        }
    }
}

void pass_over_lanes(const Passes& passes, double* memory, int num_lanes, int stride) {
    if (num_lanes > 16)
        pass_over<32 / MBOCP_WIDTH>(passes, memory, stride);
    else if (num_lanes > 8)
        pass_over<16 / MBOCP_WIDTH>(passes, memory, stride);
    else
        pass_over<8 / MBOCP_WIDTH>(passes, memory, stride);
}

}  // namespace
}  // namespace mbocp
