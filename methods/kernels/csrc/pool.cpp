#include "pool.hpp"

#include <pthread.h>

#include <atomic>
#include <condition_variable>
#include <mutex>
#include <thread>
#include <vector>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace splat {
namespace {

constexpr int SPINS = 2000;  // some 20 to 50 us of looking before sleeping: loops of one call follow closely

void pause() {
#if defined(__x86_64__)
  _mm_pause();
#elif defined(__aarch64__)
  asm volatile("yield");
#endif
}

class Pool {
 public:
  void run(int wanted, int count, const std::function<void(int, int)>& task) {
    std::lock_guard<std::mutex> turn(turn_);
    const int helpers = std::min(wanted, count) - 1;
    while ((int)workers_.size() < helpers) {
      const int number = (int)workers_.size() + 1;
      workers_.emplace_back([this, number, seen = round_.load()] { work(number, seen); });
      workers_.back().detach();
    }
    task_ = &task;
    count_ = count;
    next_ = 0;
    helpers_ = helpers;
    busy_ = (int)workers_.size();
    {
      std::lock_guard<std::mutex> lock(mutex_);
      ++round_;
    }
    wake_.notify_all();
    loop(0);
    for (int i = 0; i < SPINS && busy_.load() > 0; ++i) pause();
    std::unique_lock<std::mutex> lock(mutex_);
    done_.wait(lock, [this] { return busy_.load() == 0; });
  }

 private:
  void loop(int worker) {
    for (int i = next_++; i < count_; i = next_++) (*task_)(i, worker);
  }

  void work(int number, unsigned seen) {
    for (;;) {
      for (int i = 0; i < SPINS && round_.load() == seen; ++i) pause();
      if (round_.load() == seen) {
        std::unique_lock<std::mutex> lock(mutex_);
        wake_.wait(lock, [&] { return round_.load() != seen; });
      }
      seen = round_.load();
      if (number <= helpers_) loop(number);
      if (--busy_ == 0) {
        std::lock_guard<std::mutex> lock(mutex_);
        done_.notify_one();
      }
    }
  }

  std::mutex turn_, mutex_;
  std::condition_variable wake_, done_;
  std::vector<std::thread> workers_;
  std::atomic<unsigned> round_{0};
  std::atomic<int> next_{0}, busy_{0};
  const std::function<void(int, int)>* task_ = nullptr;
  int count_ = 0, helpers_ = 0;
};

Pool* pool = nullptr;
std::atomic<int> wanted{1};

Pool& the_pool() {
  static const bool once = [] {
    pool = new Pool;  // never destroyed: its threads may outlive main
    pthread_atfork(nullptr, nullptr, [] { pool = new Pool; });  // the parent's threads are not in the child
    return true;
  }();
  (void)once;
  return *pool;
}

}  // namespace

void set_threads(int count) { wanted = std::max(1, count); }
int threads() { return wanted; }

void parallel(int n, int count, const std::function<void(int, int)>& task) {
  if (n == 1 || count <= 1) {
    for (int i = 0; i < count; ++i) task(i, 0);
    return;
  }
  the_pool().run(n, count, task);
}

}  // namespace splat
