// CasADi's wheels carry BLASFEO for any x86-64 processor. It calls its innermost kernels through its table of imported
// functions, as shared libraries do; the entries of three of them are changed here. Matrices are panels of four rows,
// each stored by columns ("lib4"), the same as in BLASFEO's builds for AVX2.
#include "blasfeo.hpp"

#if defined(__x86_64__) && defined(__GLIBC__)

#include <dlfcn.h>
#include <immintrin.h>
#include <link.h>
#include <sys/mman.h>
#include <unistd.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>

#define MBOCP_AVX2 __attribute__((target("avx2,fma")))

namespace mbocp {
namespace {

using Gemm = void (*)(int, const double*, const double*, const double*, const double*, const double*, double*);
using GemvN = void (*)(int, const double*, const double*, const double*, const double*, const double*, double*);
using GemvT = void (*)(int, const double*, int, const double*, int, const double*, const double*, const double*,
                       double*);

// D = beta C + alpha A B', all of them 4 x 4 but for k columns of A and B.
MBOCP_AVX2 void gemm_nt(int k, const double* alpha, const double* a, const double* b, const double* beta,
                        const double* c, double* d) {
    __m256d even[4], odd[4];
    for (int j = 0; j < 4; ++j) even[j] = odd[j] = _mm256_setzero_pd();
    for (; k > 1; k -= 2, a += 8, b += 8) {
        const __m256d first = _mm256_loadu_pd(a), second = _mm256_loadu_pd(a + 4);
        for (int j = 0; j < 4; ++j) {
            even[j] = _mm256_fmadd_pd(first, _mm256_broadcast_sd(b + j), even[j]);
            odd[j] = _mm256_fmadd_pd(second, _mm256_broadcast_sd(b + 4 + j), odd[j]);
        }
    }
    if (k == 1) {
        const __m256d last = _mm256_loadu_pd(a);
        for (int j = 0; j < 4; ++j) even[j] = _mm256_fmadd_pd(last, _mm256_broadcast_sd(b + j), even[j]);
    }
    const __m256d by_alpha = _mm256_broadcast_sd(alpha), by_beta = _mm256_broadcast_sd(beta);
    for (int j = 0; j < 4; ++j)  // all of C is read before D is written: they may be the same
        even[j] = _mm256_fmadd_pd(by_alpha, _mm256_add_pd(even[j], odd[j]),
                                  _mm256_mul_pd(by_beta, _mm256_loadu_pd(c + 4 * j)));
    for (int j = 0; j < 4; ++j) _mm256_storeu_pd(d + 4 * j, even[j]);
}

// z = beta y + alpha sum
MBOCP_AVX2 inline void store(__m256d sum, const double* alpha, const double* beta, const double* y, double* z) {
    sum = _mm256_mul_pd(_mm256_broadcast_sd(alpha), sum);
    if (*beta != 0.0) sum = _mm256_fmadd_pd(_mm256_broadcast_sd(beta), _mm256_loadu_pd(y), sum);
    _mm256_storeu_pd(z, sum);
}

// z = beta y + alpha A x with the k columns of a panel.
MBOCP_AVX2 void gemv_n(int k, const double* alpha, const double* a, const double* x, const double* beta,
                       const double* y, double* z) {
    __m256d even = _mm256_setzero_pd(), odd = even;
    for (; k > 1; k -= 2, a += 8, x += 2) {
        even = _mm256_fmadd_pd(_mm256_loadu_pd(a), _mm256_broadcast_sd(x), even);
        odd = _mm256_fmadd_pd(_mm256_loadu_pd(a + 4), _mm256_broadcast_sd(x + 1), odd);
    }
    if (k == 1) even = _mm256_fmadd_pd(_mm256_loadu_pd(a), _mm256_broadcast_sd(x), even);
    store(_mm256_add_pd(even, odd), alpha, beta, y, z);
}

// z = beta y + alpha A' x with four columns of k rows, of which the first is row `offset` of its panel.
MBOCP_AVX2 void gemv_t(int k, const double* alpha, int offset, const double* a, int panel, const double* x,
                       const double* beta, const double* y, double* z) {
    std::array<double, 4> rest{};
    const auto add_row = [&] {
        for (int j = 0; j < 4; ++j) rest[static_cast<std::size_t>(j)] += a[4 * j] * *x;
        --k, ++a, ++x;
    };
    if (offset != 0) {
        for (int row = offset; row < 4 && k > 0; ++row) add_row();
        a += 4 * (panel - 1);
    }
    __m256d sums[4];
    for (auto& sum : sums) sum = _mm256_setzero_pd();
    for (; k > 3; k -= 4, a += 4 * panel, x += 4) {
        const __m256d four = _mm256_loadu_pd(x);
        for (int j = 0; j < 4; ++j) sums[j] = _mm256_fmadd_pd(_mm256_loadu_pd(a + 4 * j), four, sums[j]);
    }
    while (k > 0) add_row();
    const __m256d left = _mm256_hadd_pd(sums[0], sums[1]), right = _mm256_hadd_pd(sums[2], sums[3]);
    const __m256d sum = _mm256_add_pd(_mm256_permute2f128_pd(left, right, 0x20),
                                      _mm256_permute2f128_pd(left, right, 0x31));
    store(_mm256_add_pd(sum, _mm256_loadu_pd(rest.data())), alpha, beta, y, z);
}

// Numbers to compare kernels with, the same every time.
std::array<double, 256> some_numbers() {
    std::array<double, 256> numbers;
    for (std::size_t i = 0; i < numbers.size(); ++i) numbers[i] = std::sin(1.0 + 3.7 * static_cast<double>(i * i));
    return numbers;
}

bool agree(const std::array<double, 16>& a, const std::array<double, 16>& b) {
    for (std::size_t i = 0; i < a.size(); ++i)
        if (!(std::abs(a[i] - b[i]) <= 1e-13 * (1.0 + std::abs(a[i])))) return false;
    return true;
}

constexpr int kLongest = 11;  // columns or rows in the comparison

template <class Call>
bool same_results(const Call& call) {  // call(size, beta, into, which kernel)
    for (int size = 0; size <= kLongest; ++size)
        for (const double beta : {0.0, 1.0, -0.7}) {
            std::array<double, 16> theirs{}, ours{};
            call(size, beta, theirs.data(), false), call(size, beta, ours.data(), true);
            if (!agree(theirs, ours)) return false;
        }
    return true;
}

bool same_gemm(void* found) {
    const auto data = some_numbers();
    const double alpha = -1.3, *at = data.data();
    return same_results([&](int k, double beta, double* into, bool is_ours) {
        (is_ours ? &gemm_nt : reinterpret_cast<Gemm>(found))(k, &alpha, at, at + 64, &beta, at + 128, into);
    });
}

bool same_gemv_n(void* found) {
    const auto data = some_numbers();
    const double alpha = -1.3, *at = data.data();
    return same_results([&](int k, double beta, double* into, bool is_ours) {
        (is_ours ? &gemv_n : reinterpret_cast<GemvN>(found))(k, &alpha, at, at + 64, &beta, at + 128, into);
    });
}

bool same_gemv_t(void* found) {
    const auto data = some_numbers();
    const double alpha = -1.3, *at = data.data();
    for (int offset = 0; offset < 4; ++offset) {
        const bool same = same_results([&](int k, double beta, double* into, bool is_ours) {
            (is_ours ? &gemv_t : reinterpret_cast<GemvT>(found))(k, &alpha, offset, at + offset, 5, at + 100, &beta,
                                                                 at + 128, into);
        });
        if (!same) return false;
    }
    return true;
}

struct Kernel {
    const char* name;
    void* ours;
    bool (*is_same)(void*);
};

const std::array<Kernel, 3> kKernels{{
    {"kernel_dgemm_nt_4x4_lib4", reinterpret_cast<void*>(&gemm_nt), &same_gemm},
    {"kernel_dgemv_n_4_lib4", reinterpret_cast<void*>(&gemv_n), &same_gemv_n},
    {"kernel_dgemv_t_4_lib4", reinterpret_cast<void*>(&gemv_t), &same_gemv_t},
}};

// Where a library's calls of imported functions go through: address of the entry of each.
class Imports {
public:
    explicit Imports(const link_map& map) : base_(map.l_addr) {
        for (const ElfW(Dyn)* entry = map.l_ld; entry->d_tag != DT_NULL; ++entry) {
            const auto address = entry->d_un.d_ptr;
            if (entry->d_tag == DT_SYMTAB) symbols_ = reinterpret_cast<const ElfW(Sym)*>(address);
            if (entry->d_tag == DT_STRTAB) names_ = reinterpret_cast<const char*>(address);
            if (entry->d_tag == DT_JMPREL) entries_ = reinterpret_cast<const ElfW(Rela)*>(address);
            if (entry->d_tag == DT_PLTRELSZ) count_ = entry->d_un.d_val / sizeof(ElfW(Rela));
        }
    }

    void** entry(const char* name) const {
        if (!symbols_ || !names_ || !entries_) return nullptr;
        for (std::size_t i = 0; i < count_; ++i) {
            const auto& symbol = symbols_[ELF64_R_SYM(entries_[i].r_info)];
            if (ELF64_R_TYPE(entries_[i].r_info) == R_X86_64_JUMP_SLOT &&
                std::strcmp(names_ + symbol.st_name, name) == 0)
                return reinterpret_cast<void**>(base_ + entries_[i].r_offset);
        }
        return nullptr;
    }

private:
    ElfW(Addr) base_;
    const ElfW(Sym)* symbols_ = nullptr;
    const char* names_ = nullptr;
    const ElfW(Rela)* entries_ = nullptr;
    std::size_t count_ = 0;
};

// Whether an entry was made read-only when its library had been loaded.
struct Guarded {
    ElfW(Addr) base;
    std::uintptr_t address;
    bool found = false;

    static int look(dl_phdr_info* info, std::size_t, void* data) {
        auto& self = *static_cast<Guarded*>(data);
        if (info->dlpi_addr != self.base) return 0;
        for (int i = 0; i < info->dlpi_phnum; ++i) {
            const auto& part = info->dlpi_phdr[i];
            const auto begin = self.base + part.p_vaddr;
            if (part.p_type == PT_GNU_RELRO && begin <= self.address && self.address < begin + part.p_memsz)
                self.found = true;
        }
        return 1;
    }
};

bool write(void** entry, void* value, ElfW(Addr) base) {
    Guarded guarded{base, reinterpret_cast<std::uintptr_t>(entry)};
    dl_iterate_phdr(&Guarded::look, &guarded);
    const auto page = static_cast<std::uintptr_t>(sysconf(_SC_PAGESIZE));
    auto* const begin = reinterpret_cast<void*>(guarded.address / page * page);
    if (guarded.found && mprotect(begin, page, PROT_READ | PROT_WRITE) != 0) return false;
    __atomic_store_n(entry, value, __ATOMIC_RELEASE);
    if (guarded.found) mprotect(begin, page, PROT_READ);
    return true;
}

}  // namespace

std::vector<std::string> accelerate_blasfeo(const std::string& path) {
    std::vector<std::string> replaced;
    if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma")) return replaced;
    void* const library = dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL);  // never closed: it is changed
    link_map* map = nullptr;
    if (!library || dlinfo(library, RTLD_DI_LINKMAP, &map) != 0) return replaced;
    const Imports imports(*map);
    for (const auto& kernel : kKernels) {
        void** const entry = imports.entry(kernel.name);
        void* const theirs = dlsym(library, kernel.name);
        if (entry && theirs && kernel.is_same(theirs) && write(entry, kernel.ours, map->l_addr))
            replaced.emplace_back(kernel.name);
    }
    return replaced;
}

}  // namespace mbocp

#else

namespace mbocp {

std::vector<std::string> accelerate_blasfeo(const std::string&) { return {}; }

}  // namespace mbocp

#endif
