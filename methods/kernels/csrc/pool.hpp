// A few threads that wait for loops.
#pragma once
#include <cstdint>
#include <functional>

namespace splat {

// Threads used from now on, >= 1, by every kernel of this process.
void set_threads(int count);
int threads();

// task(i, worker) for i in [0, count), worker in [0, threads). Returns when all are done. Calls from several
// threads take turns. After fork the child starts its own threads.
void parallel(int threads, int count, const std::function<void(int task, int worker)>& task);

// task(first, last) over [0, count) in pieces that suit work done Gaussian by Gaussian.
template <class Task>
void over_gaussians(int threads, int64_t count, Task task) {
  constexpr int64_t PIECE = 512;
  parallel(threads, (int)((count + PIECE - 1) / PIECE), [&](int i, int) {
    const int64_t first = i * PIECE;
    task(first, first + PIECE < count ? first + PIECE : count);
  });
}

}  // namespace splat
