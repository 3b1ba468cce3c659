// Random matrices, and comparisons with Eigen that tell what is wrong; `main` runs all tests that are declared.
#pragma once

#include <Eigen/LU>
#include <cstdio>
#include <functional>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "../kernel/dense.hpp"

namespace mbocp::tests {

using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using Vector = Eigen::VectorXd;

constexpr double epsilon = std::numeric_limits<double>::epsilon();

struct Test {
    const char* name;
    std::function<void()> run;
};

inline std::vector<Test>& all_tests() {
    static std::vector<Test> tests;
    return tests;
}
inline std::vector<std::string>& failures() {
    static std::vector<std::string> found;
    return found;
}

struct Declared {
    Declared(const char* name, std::function<void()> run) { all_tests().push_back({name, std::move(run)}); }
};
#define TEST(name)                                                                                                     \
    static void name();                                                                                                \
    static const ::mbocp::tests::Declared name##_(#name, name);                                                        \
    static void name()

inline void check(bool is_true, const std::string& what) {
    if (!is_true) failures().push_back(what);
}

// Entries differ by `scale` times round-off at most: `scale` is the number of operations of an entry times their size.
inline void check_equal(const Matrix& found, const Matrix& expected, double scale, const std::string& what) {
    const double error = expected.size() ? (found - expected).cwiseAbs().maxCoeff() / epsilon : 0.0;
    check(error <= scale, what + ": " + std::to_string(error) + " round-offs, not " + std::to_string(scale));
}
inline void check_equal(double found, double expected, double scale, const std::string& what) {
    check_equal(Matrix::Constant(1, 1, found), Matrix::Constant(1, 1, expected), scale, what);
}

class Random {
public:
    explicit Random(unsigned seed) : generator_(seed) {}

    double normal() { return normal_(generator_); }
    int integer(int least, int most) { return std::uniform_int_distribution<int>(least, most)(generator_); }
    double uniform(double least, double most) {
        return std::uniform_real_distribution<double>(least, most)(generator_);
    }
    bool is(double probability) { return std::bernoulli_distribution(probability)(generator_); }
    Matrix matrix(int rows, int columns) {
        return Matrix::NullaryExpr(rows, columns, [this] { return normal(); });
    }
    Vector vector(int size) { return matrix(size, 1); }
    Matrix definite(int n) {
        const Matrix A = matrix(n, n);
        return A * A.transpose() / n + Matrix::Identity(n, n);
    }

private:
    std::mt19937 generator_;
    std::normal_distribution<double> normal_;
};

// Row-major with rows, and their number, padded to whole vectors by zeros, as the kernel asks for.
class Padded {
public:
    Padded(int rows, int columns)
        : ld(dense::padded(columns)), rows_(rows), columns_(columns), numbers_(Matrix::Zero(dense::padded(rows), ld)) {}
    explicit Padded(const Matrix& given) : Padded(int(given.rows()), int(given.cols())) {
        numbers_.topLeftCorner(rows_, columns_) = given;
    }
    double* data() { return numbers_.data(); }
    auto matrix() const { return numbers_.topLeftCorner(rows_, columns_); }

    int ld;

private:
    int rows_, columns_;
    Matrix numbers_;
};

}  // namespace mbocp::tests
