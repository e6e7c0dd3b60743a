// A few threads that wait for loops.
#pragma once
#include <functional>

namespace splat {

// Threads used from now on, >= 1, by every kernel of this process.
void set_threads(int count);
int threads();

// task(i, worker) for i in [0, count), worker in [0, threads). Returns when all are done. Calls from several
// threads take turns. After fork the child starts its own threads.
void parallel(int threads, int count, const std::function<void(int task, int worker)>& task);

}  // namespace splat
