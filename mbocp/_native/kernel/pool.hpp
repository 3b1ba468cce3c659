// One zeroed block of memory, on the boundary of a cache line, as for all stages. Long horizons take hundreds of
// megabytes and are walked through several times an iteration: on huge pages, where the system has them, that costs up
// to a third less.
#pragma once

#include <cstdlib>
#include <cstring>
#include <memory>
#include <new>

#ifdef __linux__
#include <sys/mman.h>
#endif

namespace mbocp {

class Pool {
public:
    double* allocate(std::size_t count) {
        const std::size_t huge = std::size_t(2) << 20, wanted = count * sizeof(double);
        const std::size_t page = wanted < 2 * huge ? 64 : huge;
        const std::size_t bytes = (wanted + page - 1) / page * page;
        void* block = nullptr;
        if (posix_memalign(&block, page, bytes) != 0) throw std::bad_alloc();
        block_.reset(static_cast<double*>(block));
#ifdef MADV_HUGEPAGE
        if (page == huge) madvise(block, bytes, MADV_HUGEPAGE);  // advice only: without it all works, if slower
#endif
        std::memset(block, 0, bytes);
        bytes_ = bytes;
        return block_.get();
    }

    double* data() const { return block_.get(); }
    std::size_t bytes() const { return bytes_; }

private:
    struct Free {
        void operator()(double* p) const { std::free(p); }
    };
    std::unique_ptr<double, Free> block_;
    std::size_t bytes_ = 0;
};

}  // namespace mbocp
