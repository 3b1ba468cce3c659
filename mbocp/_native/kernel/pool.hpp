// One zeroed block of memory, on the boundary of a cache line, as for all stages. Long horizons take hundreds of
// megabytes and are walked through several times an iteration: on huge pages, where the system has them, that costs up
// to a third less. The last block of some size that was given back is kept for the next one: problems that are solved
// one after another, and gradients of their solutions, do not wait for the system's pages.
#pragma once

#include <atomic>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <new>
#include <utility>

#ifdef __linux__
#include <sys/mman.h>
#endif

namespace mbocp {

// The block that is kept, with its size in its first bytes, or null.
inline std::atomic<double*> spare_block{nullptr};

struct GiveBack {
    static constexpr std::size_t least_kept = std::size_t(1) << 20, most_kept = std::size_t(64) << 20;  // bytes

    std::size_t bytes = 0;  // of the block

    void operator()(double* p) const {
        if (bytes < least_kept || bytes > most_kept) return std::free(p);
        std::memcpy(p, &bytes, sizeof bytes);
        std::free(spare_block.exchange(p));
    }
};

class Pool {
public:
    double* allocate(std::size_t count) {
        const std::size_t huge = std::size_t(2) << 20, wanted = count * sizeof(double);
        const std::size_t page = wanted < 2 * huge ? 64 : huge;
        const std::size_t bytes = (wanted + page - 1) / page * page;
        block_ = take_spare(bytes, page);
        if (!block_) {
            void* block = nullptr;
            if (posix_memalign(&block, page, bytes) != 0) throw std::bad_alloc();
            block_ = Block(static_cast<double*>(block), GiveBack{bytes});
#ifdef MADV_HUGEPAGE
            if (page == huge) madvise(block, bytes, MADV_HUGEPAGE);  // advice only: without it all works, if slower
#endif
        }
        std::memset(block_.get(), 0, bytes);
        bytes_ = bytes;
        return block_.get();
    }

    double* data() const { return block_.get(); }
    std::size_t bytes() const { return bytes_; }

private:
    using Block = std::unique_ptr<double, GiveBack>;

    static Block take_spare(std::size_t bytes, std::size_t page) {
        double* found = spare_block.exchange(nullptr);
        if (!found) return Block();
        std::size_t size = 0;
        std::memcpy(&size, found, sizeof size);
        Block block(found, GiveBack{size});
        const bool fits = size >= bytes && size <= 2 * bytes && reinterpret_cast<std::uintptr_t>(found) % page == 0;
        return fits ? std::move(block) : Block();  // else it goes back
    }

    Block block_;
    std::size_t bytes_ = 0;
};

}  // namespace mbocp
