/* Functions of a compiled library, some calls of which go wrong: which ones is a matter of seed and number of the call.
 *
 * Compiled with -DLIBRARY="..." and -DFUNCTIONS=F(one)F(two)...; `tough_set` says how often, and what happens.
 */
#include <dlfcn.h>
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

typedef long long Index;
typedef int (*Evaluate)(const double**, double**, Index*, double*, int);

enum { NOT_A_NUMBER, INFINITE, NOISE, FAILURE };

static uint64_t seed, calls, spoilt;
static double rate, size;
static int mode;

void tough_set(uint64_t new_seed, double new_rate, int new_mode, double new_size) {
    seed = new_seed, rate = new_rate, mode = new_mode, size = new_size;
    calls = spoilt = 0;
}

uint64_t tough_spoilt(void) { return spoilt; }

static uint64_t mixed(uint64_t z) { /* splitmix64 */
    z += 0x9e3779b97f4a7c15ULL;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
    return z ^ (z >> 31);
}

static double uniform(uint64_t z) { return (double)(mixed(z) >> 11) / 9007199254740992.0; }

static void* symbol(const char* name) {
    static void* library;
    if (!library) library = dlopen(LIBRARY, RTLD_NOW | RTLD_LOCAL);
    if (!library) abort();
    return dlsym(library, name);
}

static Index entries(const Index* s) { /* of CasADi's compact form */
    return s[2] == 1 ? s[0] * s[1] : s[2 + s[1]];
}

static double spoil(double value, uint64_t z) {
    if (mode == NOT_A_NUMBER) return NAN;
    if (mode == INFINITE) return uniform(z) < 0.5 ? INFINITY : -INFINITY;
    return value * (1.0 + size * (2.0 * uniform(z) - 1.0)) + size * (2.0 * uniform(z + 1) - 1.0);
}

/* Spoil one entry of each output that is wanted; noise, all of them. */
static int spoil_some(const char* sparsity_out, Index outputs, double** res) {
    const uint64_t number = __atomic_add_fetch(&calls, 1, __ATOMIC_RELAXED);
    const uint64_t z = mixed(seed) + 1000003ULL * number;
    if (uniform(z) >= rate) return 0;
    __atomic_add_fetch(&spoilt, 1, __ATOMIC_RELAXED);
    if (mode == FAILURE) return 1;
    const Index* (*sparsity)(Index) = symbol(sparsity_out);
    for (Index i = 0; i < outputs; ++i) {
        const Index n = entries(sparsity(i));
        if (!res[i] || !n) continue;
        if (mode == NOISE)
            for (Index k = 0; k < n; ++k) res[i][k] = spoil(res[i][k], z + 7 * (uint64_t)(i + k + 1));
        else {
            const Index k = (Index)(mixed(z + (uint64_t)i) % (uint64_t)n);
            res[i][k] = spoil(res[i][k], z + (uint64_t)i);
        }
    }
    return 0;
}

#define F(name)                                                                                     \
    Index name##_n_in(void) { return ((Index(*)(void))symbol(#name "_n_in"))(); }                   \
    Index name##_n_out(void) { return ((Index(*)(void))symbol(#name "_n_out"))(); }                 \
    const Index* name##_sparsity_in(Index i) {                                                      \
        return ((const Index* (*)(Index))symbol(#name "_sparsity_in"))(i);                          \
    }                                                                                               \
    const Index* name##_sparsity_out(Index i) {                                                     \
        return ((const Index* (*)(Index))symbol(#name "_sparsity_out"))(i);                         \
    }                                                                                               \
    const char* name##_name_in(Index i) {                                                           \
        return ((const char* (*)(Index))symbol(#name "_name_in"))(i);                               \
    }                                                                                               \
    const char* name##_name_out(Index i) {                                                          \
        return ((const char* (*)(Index))symbol(#name "_name_out"))(i);                              \
    }                                                                                               \
    int name##_work(Index* a, Index* r, Index* i, Index* w) {                                       \
        return ((int (*)(Index*, Index*, Index*, Index*))symbol(#name "_work"))(a, r, i, w);        \
    }                                                                                               \
    int name(const double** arg, double** res, Index* iw, double* w, int mem) {                     \
        static Evaluate original;                                                                   \
        if (!original) original = (Evaluate)symbol(#name);                                          \
        const int code = original(arg, res, iw, w, mem);                                            \
        return code ? code : spoil_some(#name "_sparsity_out", name##_n_out(), res);                \
    }

FUNCTIONS
