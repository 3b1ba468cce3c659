// Newton steps of random programmes against the LU of the whole KKT matrix, and their inertia against its eigenvalues.
#include <Eigen/Eigenvalues>

#include "../kernel/programme.hpp"
#include "checks.hpp"
#include "patterns.hpp"

namespace mbocp::tests {
namespace {

// A function of a stage whose outputs are written by another one.
class Made final : public StageFunction {
public:
    using Write = std::function<void(const std::vector<const double*>& arg, const std::vector<double*>& res)>;

    Made(std::vector<Pattern> patterns, std::vector<int> sizes, Write write) : write_(std::move(write)) {
        outputs = std::move(patterns), input_sizes = std::move(sizes), num_inputs = int(input_sizes.size());
        arg.resize(input_sizes.size()), res.resize(outputs.size());
        allocate();
    }
    bool call() override { return write_(arg, res), true; }
    std::shared_ptr<StageFunction> copy() const override {
        return std::make_shared<Made>(outputs, input_sizes, write_);
    }

private:
    Write write_;
};

Pattern dense_pattern(int rows, int columns) { return sparse_of(Matrix::Ones(rows, columns)).pattern; }

struct Shape {
    int N, ndx, ny, nu, ng;
    double share = 0.3;      // of a random metric in the cost
    double curvature = 0.1;  // of what makes the Hessian indefinite
    // The first `direct` rows are x0_i - w_i + slope w_{direct + i}, w = (x1, y), as where a step adds up speeds; with
    // other entries of the state before and the controls, too, if `also_before`.
    int direct = 0;
    double slope = 0.1;
    bool also_before = false;
    int lead = 0;  // the first of these have blocks in place of diagonals, and any block before w
    // So many of the first rows, every other, are x0_i - w_i + slope (w_{i + 1} + last of w), and every third of their
    // w_i is known to no other row; with other entries if `also_before`.
    int followers = 0;
    int plain = -1;         // unless -1: the last ny rows do not know x1, and so many of the first only their own of it
    bool is_split = false;  // no curvature couples x1 with y
    bool is_apart = false;  // none couples controls with others, none knows the first state before
    bool is_crossed = false;  // rows do not know the controls, whose products of two alone are in the cost

    int nc() const { return ndx + ny; }
    int nz() const { return 2 * ndx + ny + nu; }
};

// A stage J z + c, with the cost z'Hz / 2 + g'z, z = (x1, y, x0, u).
struct Quadratic {
    Matrix J, H;
    Vector c, g;
};

Quadratic random_stage(const Shape& s, const Matrix& beside, Random& random) {
    const int nc = s.nc(), nz = s.nz(), n = s.ndx;
    const Matrix W = random.matrix(nz, nz), C = random.matrix(nz, nz);
    Quadratic q{random.matrix(nc, nz), s.share * W * W.transpose() + Matrix::Identity(nz, nz), random.vector(nc),
                random.vector(nz)};
    q.J.leftCols(nc).diagonal().array() += 3.0;
    q.H += s.curvature * 0.2 * (C + C.transpose());
    for (int i = 0; i < s.direct; ++i) {
        q.J.row(i) = beside.row(i).cwiseProduct(q.J.row(i));
        q.J(i, i) = -1.0, q.J(i, s.direct + i) = s.slope, q.J(i, nc + i) = 1.0;
    }
    if (const int lead = s.lead) {
        q.J.topRows(lead).setZero();
        q.J.topLeftCorner(lead, lead) = random.matrix(lead, lead) + 3.0 * Matrix::Identity(lead, lead);
        q.J.block(0, s.direct, lead, lead) = s.slope * random.matrix(lead, lead);
        q.J.block(0, nc, lead, lead) = random.matrix(lead, lead);
    }
    for (int i = 0; i < 2 * s.followers; i += 2) {
        if (i % 3 == 0) q.J.col(i).setZero();
        q.J.row(i) = beside.row(i).cwiseProduct(q.J.row(i));
        q.J(i, i) = -1.0, q.J(i, i + 1) += s.slope, q.J(i, nc - 1) += s.slope, q.J(i, nc + i) = 1.0;
    }
    for (int i = 0; i < nc && s.plain >= 0; ++i)
        if (i < s.plain || i >= n) q.J.row(i).head(n).setZero();
    for (int i = 0; i < s.plain; ++i) q.J(i, i) = -2.0;
    if (s.is_split) q.H.block(0, n, n, s.ny).setZero(), q.H.block(n, 0, s.ny, n).setZero();
    if (s.is_apart) {
        q.H.topRightCorner(nz - s.nu, s.nu).setZero(), q.H.bottomLeftCorner(s.nu, nz - s.nu).setZero();
        q.H.row(nc).setZero(), q.H.col(nc).setZero();
        q.J.topRightCorner(s.direct, s.nu).setZero();
    }
    if (s.is_crossed) {
        q.J.rightCols(s.nu).setZero();
        q.H.bottomRightCorner(s.nu, s.nu) = Matrix::Identity(s.nu, s.nu).rowwise().reverse();
    }
    return q;
}

class RandomProgramme {
public:
    RandomProgramme(const Shape& shape, Random& random) : shape_(shape), D_(random.matrix(shape.ng, shape.ndx)) {
        Matrix beside = Matrix::Zero(shape.nc(), shape.nz());  // which entries direct rows have beside theirs
        for (double& entry : beside.rightCols(shape.ndx + shape.nu).reshaped())
            entry = shape.also_before && random.is(0.2);
        for (int n = 0; n < shape.N; ++n) stages_.push_back(random_stage(shape, beside, random));
        Kind kind;
        kind.nx = kind.ndx = shape.ndx, kind.ny = shape.ny, kind.nu = shape.nu, kind.nr = 1;
        kind.values = stage_function(2), kind.jacobian = stage_function(4), kind.complete = stage_function(5);
        kind.scale_c.assign(shape.nc(), 1.0), kind.scale_m = kind.scale_c;
        kind.scale_y.assign(shape.ny, 1.0), kind.scale_ru.assign(shape.nu, 1.0);
        const auto moved = [this](double by) {
            return std::make_shared<Made>(std::vector{dense_pattern(shape_.ndx, 1)},
                                          std::vector{shape_.ndx, shape_.ndx}, [this, by](auto& arg, auto& res) {
                                              for (int i = 0; i < shape_.ndx; ++i)
                                                  res[0][i] = by * arg[0][i] + arg[1][i];
                                          });
        };
        programme_ = std::make_unique<Programme>(shape.N, kind, Terminal{shape.ng, 0, end_function(2), end_function(5)},
                                                 moved(1.0), moved(-1.0));
        Numbers which(shape.N);
        for (int n = 0; n < shape.N; ++n) which[n] = n;
        programme_->problem.set_parameters({nullptr, 0}, {which.data(), which.size()}, {nullptr, 0});
        Iterate& at = programme_->iterate;
        for (Numbers* part : {&at.x, &at.y, &at.u, &at.m, &at.eta})
            for (double& number : *part) number = 0.3 * random.normal();
    }

    Programme& operator*() { return *programme_; }
    Programme* operator->() { return programme_.get(); }
    int num_primal() const { return shape_.N * (shape_.nc() + shape_.nu); }

    // KKT matrix and residual in the order (x_1..x_N, y, u | m, eta).
    void assemble(double shift, Matrix& K, Vector& r) const {
        const int N = shape_.N, ndx = shape_.ndx, ny = shape_.ny, nu = shape_.nu, ng = shape_.ng, nc = shape_.nc();
        const int size = num_primal() + N * nc + ng;
        K = Matrix::Zero(size, size), r = Vector::Zero(size);
        for (int n = 0; n < N; ++n) {
            const Quadratic& q = stages_[n];
            std::vector<int> place;  // of z among the unknowns; the first state is none
            const auto append = [&](int first, int count) {
                for (int i = 0; i < count; ++i) place.push_back(first + i);
            };
            append(n * ndx, ndx), append(N * ndx + n * ny, ny), append((n - 1) * ndx, ndx);
            append(N * (ndx + ny) + n * nu, nu);
            const Vector z = z_of(n), m = Eigen::Map<const Vector>(&programme_->iterate.m[n * nc], nc);
            const Vector gradient = q.H * z + q.g + q.J.transpose() * m;
            const int rows = num_primal() + n * nc;
            r.segment(rows, nc) = q.J * z + q.c;
            for (int i = 0; i < shape_.nz(); ++i) {
                if (place[i] < 0) continue;
                r[place[i]] += gradient[i];
                K.col(place[i]).segment(rows, nc) += q.J.col(i);
                for (int j = 0; j < shape_.nz(); ++j)
                    if (place[j] >= 0) K(place[i], place[j]) += q.H(i, j);
            }
        }
        const int last = (N - 1) * ndx, rows = num_primal() + N * nc;
        const Vector x = Eigen::Map<const Vector>(&programme_->iterate.x[N * ndx], ndx);
        K.block(last, last, ndx, ndx) += Matrix::Identity(ndx, ndx);
        K.block(rows, last, ng, ndx) = D_;
        r.segment(last, ndx) += x + D_.transpose() * Eigen::Map<const Vector>(programme_->iterate.eta.data(), ng);
        r.segment(rows, ng) = D_ * x + Vector::Constant(ng, 0.5);
        K.topRightCorner(num_primal(), size - num_primal()) =
            K.bottomLeftCorner(size - num_primal(), num_primal()).transpose().eval();
        K.diagonal().head(N * ndx).array() += shift;
    }

    Vector direction() const {
        const Increment& d = programme_->riccati.direction();
        Numbers all(d.dx.begin() + shape_.ndx, d.dx.end());
        for (const Numbers* part : {&d.dy, &d.du, &d.dm, &d.deta}) all.insert(all.end(), part->begin(), part->end());
        return Eigen::Map<const Vector>(all.data(), all.size());
    }

private:
    Vector z_of(int n) const {
        const Iterate& at = programme_->iterate;
        return z_from(&at.x[n * shape_.ndx], &at.x[(n + 1) * shape_.ndx], at.y.data() + n * shape_.ny,
                      at.u.data() + n * shape_.nu);
    }
    Vector z_from(const double* x0, const double* x1, const double* y, const double* u) const {
        Vector z(shape_.nz());
        const auto part = [](const double* at, int size) { return Eigen::Map<const Vector>(at, size); };
        z << part(x1, shape_.ndx), part(y, shape_.ny), part(x0, shape_.ndx), part(u, shape_.nu);
        return z;
    }

    // The first outputs of c, l, dc_dz, dl_dz, and the upper Hessian; the last takes multipliers, too.
    Function stage_function(std::size_t num_outputs) const {
        const Sparse J = sparse_of(stages_[0].J), H = sparse_of(stages_[0].H.triangularView<Eigen::Upper>());
        std::vector patterns{dense_pattern(shape_.nc(), 1), dense_pattern(1, 1), J.pattern,
                             dense_pattern(1, shape_.nz()), H.pattern};
        std::vector sizes{shape_.ndx, shape_.ndx, shape_.ny, shape_.nu};
        if (num_outputs == 5) sizes.push_back(shape_.nc());
        patterns.resize(num_outputs), sizes.insert(sizes.end(), {0, 1});
        return std::make_shared<Made>(patterns, sizes, [this, patterns](auto& arg, auto& res) {
            const Quadratic& q = stages_[std::size_t(arg.back()[0])];
            const Vector z = z_from(arg[0], arg[1], arg[2], arg[3]), c = q.J * z + q.c, g = q.H * z + q.g;
            std::copy(c.begin(), c.end(), res[0]);
            res[1][0] = 0.5 * z.dot(q.H * z) + q.g.dot(z);
            for (std::size_t o = 2; o < patterns.size(); ++o)
                for (int k = 0; k < patterns[o].nnz(); ++k) {
                    const int i = patterns[o].row[k], j = patterns[o].column[k];
                    res[o][k] = o == 2 ? q.J(i, j) : o == 3 ? g[j] : q.H(i, j);
                }
        });
    }
    // The first outputs of psi = x'x / 2, g = D x + 1 / 2, dg_dx, dpsi_dx, and the upper Hessian.
    Function end_function(std::size_t num_outputs) const {
        const int n = shape_.ndx;
        std::vector patterns{dense_pattern(1, 1), dense_pattern(shape_.ng, 1), dense_pattern(shape_.ng, n),
                             dense_pattern(1, n), sparse_of(Matrix::Identity(n, n)).pattern};
        std::vector sizes = num_outputs == 5 ? std::vector{n, shape_.ng, 0} : std::vector{n, 0};
        patterns.resize(num_outputs);
        return std::make_shared<Made>(patterns, sizes, [this, n](auto& arg, auto& res) {
            const Eigen::Map<const Vector> x(arg[0], n);
            const Vector g = D_ * x + Vector::Constant(shape_.ng, 0.5);
            res[0][0] = 0.5 * x.squaredNorm();
            std::copy(g.begin(), g.end(), res[1]);
            if (res.size() == 2) return;
            for (int j = 0; j < n; ++j) {
                for (int i = 0; i < shape_.ng; ++i) res[2][j * shape_.ng + i] = D_(i, j);
                res[3][j] = x[j], res[4][j] = 1.0;
            }
        });
    }

    Shape shape_;
    Matrix D_;
    std::vector<Quadratic> stages_;
    std::unique_ptr<Programme> programme_;
};

// A direction and its inertia; how many negative eigenvalues there are beyond one for each row, or -1 where the matrix
// is next to singular.
int check_direction(const Shape& shape, Random& random, double shift = 0.0, double augment = 0.0) {
    RandomProgramme programme(shape, random);
    Matrix K;
    Vector r;
    programme.assemble(shift, K, r);
    const Vector eigenvalues = Eigen::SelfAdjointEigenSolver<Matrix>(K, Eigen::EigenvaluesOnly).eigenvalues();
    if (eigenvalues.cwiseAbs().minCoeff() < 1e-6 * eigenvalues.cwiseAbs().maxCoeff()) return -1;
    const int excess = int((eigenvalues.array() < 0.0).count()) - (int(K.rows()) - programme.num_primal());
    const std::string what = "N " + std::to_string(shape.N) + ", ndx " + std::to_string(shape.ndx) + ", ny " +
                             std::to_string(shape.ny) + ", nu " + std::to_string(shape.nu) + ", direct " +
                             std::to_string(shape.direct) + ", lead " + std::to_string(shape.lead) + ", followers " +
                             std::to_string(shape.followers) + ", plain " + std::to_string(shape.plain);
    const Evaluation evaluation = programme->evaluate(1.0);
    check_equal(evaluation.residual, r.norm(), 1e4 * r.norm(), what + ": residual");
    const Factorisation factorisation = programme->riccati.factorise(shift, augment);
    check(factorisation.ok, what + ": singular");
    if (!factorisation.ok) return -1;
    check(factorisation.negative - shape.ng == excess, what + ": inertia");
    programme->riccati.solve_motion();
    const Vector motion = programme.direction().head(programme.num_primal());
    const Direction found = programme->riccati.solve(1);
    const Vector direction = programme.direction(), expected = K.partialPivLu().solve(-r);
    // With eigenvalues a factor of 1e6 apart at most, and one refinement.
    check_equal(K * direction, -r, 1e-9 / epsilon * r.cwiseAbs().maxCoeff(), what + ": linear residual");
    check_equal(direction, expected, 1e-8 / epsilon * expected.cwiseAbs().maxCoeff(), what + ": direction");
    const double without_refinement = 1e-6 / epsilon * expected.cwiseAbs().maxCoeff();
    check_equal(motion, expected.head(motion.size()), without_refinement, what + ": motion");
    check_equal(found.increment, expected.norm(), 1e-8 / epsilon * expected.norm(), what + ": increment");
    return excess;
}

// Sizes with and without kernels of their own, rows of all forms that a step may have, definite and indefinite.
TEST(any_shape) {
    Random random(31);
    int regular = 0, indefinite = 0;
    for (int trial = 0; trial < 400; ++trial) {
        Shape s{random.integer(1, 4), random.integer(1, 9), random.integer(0, 12), random.integer(1, 10), 0};
        s.ng = random.integer(0, std::min(s.ndx, s.nu * s.N));
        s.share = random.is(0.5) ? 0.3 : 0.0;
        s.curvature = random.is(0.5) ? 0.1 : 4.0;
        s.direct = random.integer(0, std::min(s.ndx, s.nc() / 2));
        s.slope = std::vector{0.02, -0.7, 3.0}[random.integer(0, 2)];  // the last: too steep to go without pivoting
        s.also_before = random.is(0.5), s.is_split = random.is(0.5), s.is_apart = random.is(0.5);
        const int form = random.integer(0, 2);
        if (form == 1) s.direct = 0, s.plain = random.integer(0, s.ndx);
        if (form == 2) s.direct = random.integer(1, 9), s.ndx = 2 * s.direct, s.ny = 0;
        const double shift = random.is(0.5) ? 0.5 : 0.0, augment = random.is(0.5) ? 10.0 : 0.0;
        const int excess = check_direction(s, random, shift, augment);
        regular += excess >= 0, indefinite += excess > 0;
    }
    check(regular > 300 && indefinite > 50 && regular - indefinite > 100, "matrices of all kinds");
}

// As many joints as leave their base a block of its own, or a base that is too steep for that.
TEST(floating_bases) {
    Random random(33);
    int regular = 0;
    for (int trial = 0; trial < 30; ++trial) {
        Shape s{random.integer(1, 3), 0, random.integer(0, 3), random.integer(1, 10), 0};
        s.direct = random.integer(12, 15), s.ndx = 2 * s.direct, s.ng = random.integer(0, s.nu * s.N);
        s.lead = random.integer(2, 6), s.slope = random.is(0.8) ? 0.02 : 3.0;
        s.also_before = random.is(0.5), s.is_apart = random.is(0.5);
        regular += check_direction(s, random, random.is(0.5) ? 0.5 : 0.0, random.is(0.5) ? 10.0 : 0.0) >= 0;
    }
    check(regular > 15, "matrices that are not singular");
}

// Rows that follow from others, among these, some too steep to do without pivoting.
TEST(followers) {
    Random random(34);
    int regular = 0, indefinite = 0;
    for (int trial = 0; trial < 60; ++trial) {
        Shape s{random.integer(1, 3), random.integer(16, 22), random.integer(0, 8), random.integer(1, 10), 0};
        s.ng = random.integer(0, std::min(s.ndx, s.nu * s.N));
        s.followers = random.integer(8, s.ndx / 2), s.slope = random.is(0.8) ? 0.1 : 3.0;
        s.share = random.is(0.5) ? 0.3 : 0.0, s.curvature = random.is(0.5) ? 0.1 : 4.0;
        s.also_before = random.is(0.5), s.is_split = random.is(0.5), s.is_apart = random.is(0.5);
        const int excess = check_direction(s, random, random.is(0.5) ? 0.5 : 0.0, random.is(0.5) ? 10.0 : 0.0);
        regular += excess >= 0, indefinite += excess > 0;
    }
    const std::string counts = std::to_string(regular) + " regular, " + std::to_string(indefinite) + " indefinite";
    check(regular > 30 && indefinite > 5, "matrices of both kinds: " + counts);
}

TEST(controls_without_pivots_of_their_own) {
    Random random(32);
    for (int nu = 2; nu <= 10; ++nu) {
        Shape s{3, 4, 1, nu, 0};
        s.direct = 2, s.is_crossed = true;
        check(check_direction(s, random) >= 0, "crossed controls are singular");
    }
}

}  // namespace
}  // namespace mbocp::tests
