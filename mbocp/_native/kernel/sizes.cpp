#include "sizes.hpp"

#include <algorithm>
#include <cmath>

#include "dense.hpp"

namespace mbocp {

namespace {

constexpr double small = 1e-300;  // sums of squares below it have lost digits

double squares(const Numbers& values) {
    return dense::dot(static_cast<int>(values.size()), values.data(), values.data());
}

// From a sum of squares; where that is no number, or next to none, once more with the largest one taken out of it.
template <class ForEach>
double root(double squared, ForEach for_each) {
    if (std::isnan(squared) || (squared > small && std::isfinite(squared))) return std::sqrt(squared);
    double largest = 0.0, sum = 0.0;
    for_each([&](double v) { largest = std::max(largest, std::abs(v)); });
    if (largest == 0.0 || std::isinf(largest)) return largest;
    for_each([&](double v) { sum += v / largest * (v / largest); });
    return largest * std::sqrt(sum);
}

}  // namespace

double norm(std::initializer_list<const Numbers*> parts) {
    double squared = 0.0;
    for (const Numbers* part : parts) squared += squares(*part);
    return root(squared, [&](auto visit) {
        for (const Numbers* part : parts) std::for_each(part->begin(), part->end(), visit);
    });
}

Sizes sizes_of(const Problem& problem, const Iterate& at, const Barrier& barrier) {
    const auto multipliers = [&](auto visit) {
        for (int n = 0; n < problem.N; ++n) {
            const Kind& k = problem.kind();
            const double* m = at.m.data() + problem.m_offset[n];
            for (int i = 0; i < k.nc(); ++i) visit(m[i] * k.scale_m[i]);
        }
        std::for_each(at.eta.begin(), at.eta.end(), visit);
        for (std::size_t i = 0; i < barrier.z_upper.size(); ++i) visit(barrier.z_upper[i] - barrier.z_lower[i]);
    };
    double squared = 0.0;
    multipliers([&](double v) { squared += v * v; });
    return {norm({&at.x, &at.u}), root(squared, multipliers)};
}

}  // namespace mbocp
