// Threads that share loops over stages.
//
// The calling thread works, too, and waits for nobody who has not begun: a loop that it has ended alone before another
// thread woke up is over. Threads that have nothing to do look out for work for a moment, and sleep then. What is
// computed never depends on who does it.
#pragma once

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <exception>
#include <limits>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

namespace mbocp {

// Whether a loop is worth sharing, by how long it takes: now and then it is run twice by one thread and, unless that is
// too short, twice by all; the quicker way is taken in between. Sharing ends before that where it takes longer than one
// thread did, as on a machine that others use, too.
class Section {
public:
    using Clock = std::chrono::steady_clock;

    bool begin() {
        const int turn = turn_++ % period;
        if (turn == 0) least_[0] = least_[1] = std::numeric_limits<double>::infinity();
        if (turn == 2 * probes) recent_ = least_[1];
        if (turn < 2 * probes)
            is_shared_ = turn >= probes && least_[0] > too_short;
        else
            is_shared_ = recent_ < worthwhile * least_[0];
        begun_ = Clock::now();
        return is_shared_;
    }
    void end() {
        const double seconds = std::chrono::duration<double>(Clock::now() - begun_).count();
        if (seconds < least_[is_shared_]) least_[is_shared_] = seconds;
        if (is_shared_) recent_ += 0.25 * (seconds - recent_);
    }

private:
    static constexpr int period = 128, probes = 2;
    static constexpr double too_short = 15e-6;  // [s]
    static constexpr double worthwhile = 0.95;  // of what one thread takes

    double least_[2] = {}, recent_ = 0;  // alone and shared; of the last shared ones
    int turn_ = 0;
    bool is_shared_ = false;
    Clock::time_point begun_;
};

class Crew {
public:
    explicit Crew(int num_threads);
    ~Crew();
    Crew(const Crew&) = delete;
    Crew& operator=(const Crew&) = delete;

    int size() const { return 1 + static_cast<int>(threads_.size()); }
    long num_shared() const { return num_shared_; }  // loops so far

    // work(thread, first, last) for parts that make up [0, count), each by one thread, after a begin(thread) of it; the
    // calling thread is thread 0. Where a loop is not worth sharing, or may not be, all of it is one part.
    template <class Begin, class Work>
    void share(Section& section, int count, bool may_share, const Begin& begin, const Work& work) {
        const bool is_possible = may_share && size() > 1 && count > 1;
        if (is_possible && section.begin()) {
            const int length = std::max(1, count / (parts_of_thread * size()));
            std::atomic<int> next{0};
            together([&](int thread) {
                int first = next.fetch_add(length, std::memory_order_relaxed);
                if (first < count) begin(thread);
                for (; first < count; first = next.fetch_add(length, std::memory_order_relaxed))
                    work(thread, first, std::min(first + length, count));
            });
        } else {
            begin(0);
            work(0, 0, count);
        }
        if (is_possible) section.end();
    }

    // work(thread) by the calling thread, 0, and by those others that come before it has ended.
    template <class Work>
    void together(const Work& work) {
        run([](const void* w, int thread) { (*static_cast<const Work*>(w))(thread); }, &work);
    }

    // A moment of waiting for another thread, the longer the more have gone by.
    static void wait(int moments);

private:
    static constexpr int parts_of_thread = 4;

    using Call = void (*)(const void*, int);

    void run(Call call, const void* work);
    void serve(int thread);
    bool enter(std::uint32_t number);
    void wait_for_work(std::uint32_t after);

    // Of the work at hand: its number in the upper half; below whether nobody may come any more, and how many have.
    static constexpr std::uint64_t closed = std::uint64_t(1) << 31;
    std::atomic<std::uint64_t> state_{closed};
    std::atomic<int> left_{0}, sleeping_{0};
    std::atomic<bool> is_over_{false};
    Call call_ = nullptr;
    const void* work_ = nullptr;
    std::exception_ptr error_;
    std::mutex mutex_;
    std::condition_variable woken_;
    std::vector<std::thread> threads_;
    long num_shared_ = 0;
};

// What each item of a sequence needs before its turn, done by other threads ahead of the one that takes the items in
// turn; that does itself what nobody has begun.
class Ahead {
public:
    explicit Ahead(int count) : count_(count), states_(new std::atomic<char>[num_chunks()]) {}

    void start() {
        for (int chunk = 0; chunk < num_chunks(); ++chunk) states_[chunk].store(open, std::memory_order_relaxed);
    }
    template <class Work>
    void help(const Work& work) {
        for (int chunk = 0; chunk < num_chunks(); ++chunk) take(chunk, work);
    }
    // Before the turn of `item`.
    template <class Work>
    void need(int item, const Work& work) {
        if (item % length || take(item / length, work)) return;
        for (int moments = 0; states_[item / length].load(std::memory_order_acquire) != done; ++moments)
            Crew::wait(moments);
    }

private:
    static constexpr int length = 4;  // of a chunk
    static constexpr char open = 0, taken = 1, done = 2;

    int num_chunks() const { return (count_ + length - 1) / length; }
    template <class Work>
    bool take(int chunk, const Work& work) {
        char expected = open;
        if (!states_[chunk].compare_exchange_strong(expected, taken, std::memory_order_acq_rel)) return false;
        for (int item = chunk * length; item < std::min((chunk + 1) * length, count_); ++item) work(item);
        states_[chunk].store(done, std::memory_order_release);
        return true;
    }

    const int count_;
    std::unique_ptr<std::atomic<char>[]> states_;
};

// What follows each item of a sequence after its turn, in turn, done by one other thread behind the one that takes the
// items; that does itself what is left in the end.
class Behind {
public:
    void start() { allowed_ = next_ = 0, is_closed_ = is_busy_ = false; }
    // All items below this one have had their turn.
    void allow(int item) { allowed_.store(item, std::memory_order_release); }
    template <class Work>
    void help(const Work& work) {
        for (int moments = 0;; ++moments) {
            is_busy_ = true;
            if (is_closed_) break;
            const int last = allowed_.load(std::memory_order_acquire);
            if (next_ < last) moments = 0;
            while (next_ < last) work(next_++);
            is_busy_ = false;
            Crew::wait(moments);
        }
        is_busy_ = false;
    }
    // After the last turn: the rest up to this item.
    template <class Work>
    void finish(int count, const Work& work) {
        is_closed_ = true;
        for (int moments = 0; is_busy_; ++moments) Crew::wait(moments);
        while (next_ < count) work(next_++);
    }

private:
    std::atomic<int> allowed_{0};
    std::atomic<bool> is_closed_{false}, is_busy_{false};
    int next_ = 0;  // of the thread that is busy
};

}  // namespace mbocp
