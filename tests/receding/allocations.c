/* Counts what a process takes from the heap; loaded before the C library (LD_PRELOAD). */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stddef.h>

extern void* __libc_malloc(size_t);
extern void* __libc_calloc(size_t, size_t);
extern void* __libc_realloc(void*, size_t);
extern void* __libc_memalign(size_t, size_t);

static long taken;

long num_allocations(void) { return taken; }

void* malloc(size_t size) {
    ++taken;
    return __libc_malloc(size);
}

void* calloc(size_t count, size_t size) {
    ++taken;
    return __libc_calloc(count, size);
}

void* realloc(void* block, size_t size) {
    ++taken;
    return __libc_realloc(block, size);
}

int posix_memalign(void** block, size_t alignment, size_t size) {
    ++taken;
    *block = __libc_memalign(alignment, size);
    return *block ? 0 : 12;
}

void* aligned_alloc(size_t alignment, size_t size) {
    ++taken;
    return __libc_memalign(alignment, size);
}
