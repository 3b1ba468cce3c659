// Time of each operation of dense.hpp against Eigen's, at the sizes of stages: one markdown table.
//
// Eigen gets the same row-major memory with padded rows, the same compiler options, its best of dynamic and of fixed
// maximal sizes, and for products the best of `noalias` and `lazyProduct`. The two sides run in turn; the shortest of
// many samples counts. Built on request only: `make bench-dense`.
#include "../kernel/dense.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <functional>
#include <limits>
#include <random>
#include <string>
#include <vector>

namespace {

using namespace mbocp;
using dense::padded;
using Clock = std::chrono::steady_clock;

constexpr int most = 96, samples = 400;
constexpr double sample_time = 1e-5;  // [s]

template <int Max>
using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor, Max, Max>;
template <int Max>
using Vector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, Max, 1>;
template <int Max>
using RowsMap = Eigen::Map<Rows<Max>, Eigen::Unaligned, Eigen::OuterStride<>>;
template <int Max>
using VectorMap = Eigen::Map<Vector<Max>, Eigen::Unaligned>;

// Matrices and vectors of one size; A is diagonally dominant, M symmetric, positive definite.
struct Operands {
    int n, ld;
    Eigen::VectorXd A_, M_, B_, C_, x_, y_, work_;
    std::vector<int> pivot;

    explicit Operands(int size) : n(size), ld(padded(size)), pivot(static_cast<std::size_t>(size)) {
        std::mt19937 generator(7);
        std::normal_distribution<double> normal;
        for (Eigen::VectorXd* m : {&A_, &M_, &B_, &C_, &work_}) {
            m->setZero(ld * ld);
            for (int i = 0; i < n; ++i)
                for (int j = 0; j < n; ++j) (*m)[i * ld + j] = normal(generator) / n;
        }
        for (int i = 0; i < n; ++i) {
            A_[i * ld + i] += 2.0;
            for (int j = 0; j < i; ++j) M_[i * ld + j] = M_[j * ld + i];
            M_[i * ld + i] += 3.0;
        }
        x_ = Eigen::VectorXd::LinSpaced(ld, 0.5, 1.5) / n, y_ = x_.reverse();
    }
    double* A() { return A_.data(); }
    double* M() { return M_.data(); }
    double* B() { return B_.data(); }
    double* C() { return C_.data(); }
    double* x() { return x_.data(); }
    double* y() { return y_.data(); }
    double* work() { return work_.data(); }
    template <int Max>
    RowsMap<Max> rows(double* p) {
        return RowsMap<Max>(p, n, n, Eigen::OuterStride<>(ld));
    }
    template <int Max>
    VectorMap<Max> vector(double* p) {
        return VectorMap<Max>(p, n);
    }
};

using Run = std::function<void(int)>;  // that many times

// Keeps what is computed, and that it is computed each time.
void keep(const void* p) { asm volatile("" : : "g"(p) : "memory"); }

template <class Operation>
Run repeated(Operation operation) {
    return [operation](int count) mutable {
        for (int i = 0; i < count; ++i) {
            operation();
            keep(nullptr);
        }
    };
}

double seconds(const Run& run, int count) {
    const auto start = Clock::now();
    run(count);
    return std::chrono::duration<double>(Clock::now() - start).count();
}

struct Entry {
    std::string name;
    std::function<Run(Operands&)> own;
    std::vector<std::function<Run(Operands&)>> eigen;
};

// The shortest time of one call of each, in turn.
std::vector<double> measure(const std::vector<Run>& runs) {
    std::vector<double> best(runs.size(), std::numeric_limits<double>::infinity());
    std::vector<int> counts;
    for (const Run& run : runs) {
        int count = 1;
        while (seconds(run, count) < sample_time) count *= 2;
        counts.push_back(count);
    }
    for (int s = 0; s < samples; ++s)
        for (std::size_t i = 0; i < runs.size(); ++i)
            best[i] = std::min(best[i], seconds(runs[i], counts[i]) / counts[i]);
    return best;
}

void fill_copy(Operands& o, const double* from) { dense::copy(from, o.work(), o.n * o.ld); }

template <int Max>
void add_eigen(std::vector<Entry>& entries) {
    const auto add = [&](const char* name, std::function<Run(Operands&)> run) {
        for (Entry& e : entries)
            if (e.name == name) e.eigen.push_back(std::move(run));
    };
    // Products, with their general and their coefficient-wise kernels.
    add("gemm_tn", [](Operands& o) {
        return repeated([&o] { o.rows<Max>(o.C()).noalias() += o.rows<Max>(o.A()).transpose() * o.rows<Max>(o.B()); });
    });
    add("gemm_tn", [](Operands& o) {
        return repeated([&o] { o.rows<Max>(o.C()) += o.rows<Max>(o.A()).transpose().lazyProduct(o.rows<Max>(o.B())); });
    });
    add("gemm_nn", [](Operands& o) {
        return repeated([&o] { o.rows<Max>(o.C()).noalias() += o.rows<Max>(o.A()) * o.rows<Max>(o.B()); });
    });
    add("gemm_nn", [](Operands& o) {
        return repeated([&o] { o.rows<Max>(o.C()) += o.rows<Max>(o.A()).lazyProduct(o.rows<Max>(o.B())); });
    });
    add("gemv", [](Operands& o) {
        return repeated([&o] { o.vector<Max>(o.y()).noalias() += o.rows<Max>(o.A()) * o.vector<Max>(o.x()); });
    });
    add("gemv", [](Operands& o) {
        return repeated([&o] { o.vector<Max>(o.y()) += o.rows<Max>(o.A()).lazyProduct(o.vector<Max>(o.x())); });
    });
    add("gemv_t", [](Operands& o) {
        return repeated(
            [&o] { o.vector<Max>(o.y()).noalias() += o.rows<Max>(o.A()).transpose() * o.vector<Max>(o.x()); });
    });
    add("gemv_t", [](Operands& o) {
        return repeated(
            [&o] { o.vector<Max>(o.y()) += o.rows<Max>(o.A()).transpose().lazyProduct(o.vector<Max>(o.x())); });
    });
    add("axpy", [](Operands& o) { return repeated([&o] { o.vector<Max>(o.y()) += 1e-9 * o.vector<Max>(o.x()); }); });
    add("dot",
        [](Operands& o) { return repeated([&o] { o.work()[0] = o.vector<Max>(o.x()).dot(o.vector<Max>(o.y())); }); });
    add("largest",
        [](Operands& o) { return repeated([&o] { o.work()[0] = o.vector<Max>(o.x()).cwiseAbs().maxCoeff(); }); });
    // Factorisations in place; both sides copy their matrix first.
    add("lu_factor", [](Operands& o) {
        return repeated([&o] {
            fill_copy(o, o.A());
            RowsMap<Max> A = o.rows<Max>(o.work());
            Eigen::PartialPivLU<Eigen::Ref<Rows<Max>, 0, Eigen::OuterStride<>>> lu(A);
            keep(&lu);
        });
    });
    add("cholesky", [](Operands& o) {
        return repeated([&o] {
            fill_copy(o, o.M());
            RowsMap<Max> M = o.rows<Max>(o.work());
            Eigen::LLT<Eigen::Ref<Rows<Max>, 0, Eigen::OuterStride<>>> llt(M);
            keep(&llt);
        });
    });
    // Solutions with factors at hand.
    const auto lu_of = [](Operands& o) { return Eigen::PartialPivLU<Rows<Max>>(o.rows<Max>(o.A())); };
    const auto llt_of = [](Operands& o) { return Eigen::LLT<Rows<Max>>(o.rows<Max>(o.M())); };
    add("lu_solve", [lu_of](Operands& o) {
        return repeated([&o, lu = lu_of(o)] {
            fill_copy(o, o.B());
            RowsMap<Max> B = o.rows<Max>(o.work());
            B = lu.permutationP() * B;
            lu.matrixLU().template triangularView<Eigen::UnitLower>().solveInPlace(B);
            lu.matrixLU().template triangularView<Eigen::Upper>().solveInPlace(B);
        });
    });
    add("lu_solve_vector", [lu_of](Operands& o) {
        return repeated([&o, lu = lu_of(o)] {
            dense::copy(o.x(), o.work(), o.n);
            VectorMap<Max> b = o.vector<Max>(o.work());
            b = lu.permutationP() * b;
            lu.matrixLU().template triangularView<Eigen::UnitLower>().solveInPlace(b);
            lu.matrixLU().template triangularView<Eigen::Upper>().solveInPlace(b);
        });
    });
    add("lu_solve_transposed", [lu_of](Operands& o) {
        return repeated([&o, lu = lu_of(o)] {
            dense::copy(o.x(), o.work(), o.n);
            VectorMap<Max> b = o.vector<Max>(o.work());
            lu.matrixLU().transpose().template triangularView<Eigen::Lower>().solveInPlace(b);
            lu.matrixLU().transpose().template triangularView<Eigen::UnitUpper>().solveInPlace(b);
            b = lu.permutationP().transpose() * b;
        });
    });
    add("cholesky_solve", [llt_of](Operands& o) {
        return repeated([&o, llt = llt_of(o)] {
            fill_copy(o, o.B());
            RowsMap<Max> B = o.rows<Max>(o.work());
            llt.solveInPlace(B);
        });
    });
    add("cholesky_solve_vector", [llt_of](Operands& o) {
        return repeated([&o, llt = llt_of(o)] {
            dense::copy(o.x(), o.work(), o.n);
            VectorMap<Max> b = o.vector<Max>(o.work());
            llt.solveInPlace(b);
        });
    });
}

std::vector<Entry> own_entries() {
    const auto lu_of = [](Operands& o) {
        dense::lu_factor(o.n, o.A(), o.ld, o.pivot.data());
        return o.A();
    };
    const auto llt_of = [](Operands& o) {
        dense::cholesky(o.n, o.M(), o.ld);
        return o.M();
    };
    return {
        {"gemm_tn",
         [](Operands& o) {
             return repeated([&o] { dense::gemm_tn(o.n, o.n, o.n, o.A(), o.ld, o.B(), o.ld, o.C(), o.ld); });
         },
         {}},
        {"gemm_nn",
         [](Operands& o) {
             return repeated([&o] { dense::gemm_nn(o.n, o.n, o.n, o.A(), o.ld, o.B(), o.ld, o.C(), o.ld); });
         },
         {}},
        {"gemv", [](Operands& o) { return repeated([&o] { dense::gemv(o.n, o.n, o.A(), o.ld, o.x(), o.y()); }); }, {}},
        {"gemv_t",
         [](Operands& o) { return repeated([&o] { dense::gemv_t(o.n, o.n, o.A(), o.ld, o.x(), o.y()); }); },
         {}},
        {"axpy", [](Operands& o) { return repeated([&o] { dense::axpy(o.n, 1e-9, o.x(), o.y()); }); }, {}},
        {"dot", [](Operands& o) { return repeated([&o] { o.work()[0] = dense::dot(o.n, o.x(), o.y()); }); }, {}},
        {"largest", [](Operands& o) { return repeated([&o] { o.work()[0] = dense::largest(o.n, o.x()); }); }, {}},
        {"lu_factor",
         [](Operands& o) {
             return repeated([&o] {
                 fill_copy(o, o.A());
                 dense::lu_factor(o.n, o.work(), o.ld, o.pivot.data());
             });
         },
         {}},
        {"lu_solve",
         [lu_of](Operands& o) {
             return repeated([&o, lu = lu_of(o)] {
                 fill_copy(o, o.B());
                 dense::lu_solve(o.n, lu, o.ld, o.pivot.data(), o.work(), o.ld, o.ld);
             });
         },
         {}},
        {"lu_solve_vector",
         [lu_of](Operands& o) {
             return repeated([&o, lu = lu_of(o)] {
                 dense::copy(o.x(), o.work(), o.n);
                 dense::lu_solve_vector(o.n, lu, o.ld, o.pivot.data(), o.work());
             });
         },
         {}},
        {"lu_solve_transposed",
         [lu_of](Operands& o) {
             return repeated([&o, lu = lu_of(o)] {
                 dense::copy(o.x(), o.work(), o.n);
                 dense::lu_solve_transposed(o.n, lu, o.ld, o.pivot.data(), o.work());
             });
         },
         {}},
        {"cholesky",
         [](Operands& o) {
             return repeated([&o] {
                 fill_copy(o, o.M());
                 dense::cholesky(o.n, o.work(), o.ld);
             });
         },
         {}},
        {"cholesky_solve",
         [llt_of](Operands& o) {
             return repeated([&o, llt = llt_of(o)] {
                 fill_copy(o, o.B());
                 dense::cholesky_solve(o.n, llt, o.ld, o.work(), o.ld, o.ld);
             });
         },
         {}},
        {"cholesky_solve_vector",
         [llt_of](Operands& o) {
             return repeated([&o, llt = llt_of(o)] {
                 dense::copy(o.x(), o.work(), o.n);
                 dense::cholesky_solve_vector(o.n, llt, o.ld, o.work());
             });
         },
         {}},
    };
}

}  // namespace

int main() {
    std::vector<Entry> entries = own_entries();
    add_eigen<Eigen::Dynamic>(entries);
    add_eigen<most>(entries);
    const int sizes[] = {4, 8, 12, 24, 48, 96};
    std::printf("Eigen %d.%d.%d; ns by dense.hpp / ns by Eigen (ratio of Eigen's time to ours)\n\n",
                EIGEN_WORLD_VERSION, EIGEN_MAJOR_VERSION, EIGEN_MINOR_VERSION);
    std::printf("| operation |");
    for (const int n : sizes) std::printf(" %d |", n);
    std::printf("\n|---|");
    for (std::size_t i = 0; i < std::size(sizes); ++i) std::printf("---|");
    for (const Entry& e : entries) {
        std::printf("\n| `%s` |", e.name.c_str());
        for (const int n : sizes) {
            std::vector<Operands> operands(1 + e.eigen.size(), Operands(n));  // each its own: factors spoil theirs
            std::vector<Run> runs{e.own(operands[0])};
            for (std::size_t i = 0; i < e.eigen.size(); ++i) runs.push_back(e.eigen[i](operands[i + 1]));
            const std::vector<double> best = measure(runs);
            const double eigen = *std::min_element(best.begin() + 1, best.end());
            std::printf(" %.0f / %.0f (%.2f) |", 1e9 * best[0], 1e9 * eigen, eigen / best[0]);
            std::fflush(stdout);
        }
    }
    std::printf("\n");
}
