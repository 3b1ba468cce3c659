#include "crew.hpp"

#include <signal.h>

#include <stdexcept>

namespace mbocp {

namespace {

constexpr std::chrono::microseconds looking_out{200};  // as long as what Python does between two loops
constexpr int looks = 64;                              // between two looks at the clock

void pause() {
#if defined(__x86_64__) || defined(__i386__)
    __builtin_ia32_pause();
#elif defined(__aarch64__)
    asm volatile("yield");
#endif
}

std::uint32_t number_of(std::uint64_t state) { return static_cast<std::uint32_t>(state >> 32); }

}  // namespace

Crew::Crew(int num_threads) {
    if (num_threads < 1) throw std::invalid_argument("threads: expected one at least");
    if (num_threads == 1) return;
    sigset_t all, before;  // signals are for the threads of Python
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &before);
    try {
        for (int thread = 1; thread < num_threads; ++thread) threads_.emplace_back([this, thread] { serve(thread); });
    } catch (...) {  // the system has no more of them: as many as there are
    }
    pthread_sigmask(SIG_SETMASK, &before, nullptr);
}

Crew::~Crew() {
    {
        const std::lock_guard<std::mutex> lock(mutex_);
        is_over_ = true;
    }
    woken_.notify_all();
    for (std::thread& thread : threads_) thread.join();
}

void Crew::run(Call call, const void* work) {
    ++num_shared_;
    call_ = call, work_ = work, error_ = nullptr;
    left_.store(0, std::memory_order_relaxed);
    state_.store(std::uint64_t(number_of(state_.load(std::memory_order_relaxed)) + 1) << 32);
    if (sleeping_.load() > 0) {
        const std::lock_guard<std::mutex> lock(mutex_);
        woken_.notify_all();
    }
    std::exception_ptr own;
    try {
        call(work, 0);
    } catch (...) {
        own = std::current_exception();
    }
    const auto came = static_cast<int>(state_.fetch_or(closed) & (closed - 1));
    for (int moments = 0; left_.load(std::memory_order_acquire) != came; ++moments) wait(moments);
    if (own) std::rethrow_exception(own);
    if (error_) std::rethrow_exception(error_);
}

void Crew::wait(int moments) { moments % looks == looks - 1 ? std::this_thread::yield() : pause(); }

void Crew::serve(int thread) {
    for (std::uint32_t number = 0;;) {
        wait_for_work(number);
        if (is_over_.load()) return;
        number = number_of(state_.load(std::memory_order_acquire));
        if (!enter(number)) continue;
        try {
            call_(work_, thread);
        } catch (...) {
            const std::lock_guard<std::mutex> lock(mutex_);
            if (!error_) error_ = std::current_exception();
        }
        left_.fetch_add(1, std::memory_order_release);
    }
}

bool Crew::enter(std::uint32_t number) {
    std::uint64_t state = state_.load(std::memory_order_acquire);
    while (number_of(state) == number && !(state & closed))
        if (state_.compare_exchange_weak(state, state + 1, std::memory_order_acq_rel)) return true;
    return false;
}

void Crew::wait_for_work(std::uint32_t after) {
    const auto has_work = [&] { return number_of(state_.load()) != after || is_over_.load(); };
    const auto until = std::chrono::steady_clock::now() + looking_out;
    for (int k = 1; !has_work(); ++k) {
        pause();
        if (k % looks || std::chrono::steady_clock::now() < until) continue;
        std::unique_lock<std::mutex> lock(mutex_);
        ++sleeping_;
        woken_.wait(lock, has_work);
        --sleeping_;
        return;
    }
}

}  // namespace mbocp
