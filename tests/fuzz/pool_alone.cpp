// The pool without Python: two threads ask for loops of many sizes; with an argument a counter is shared, which is a race.
#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <thread>
#include <vector>

#include "pool.hpp"

int main(int arguments, char**) {
  std::atomic<long> done{0};
  long shared = 0;
  auto ask = [&](int first) {
    for (int round = 0; round < 3000; ++round) {
      const int count = (first + round * 7) % 40;
      std::vector<int> own(count);
      splat::parallel(2 + round % 6, count, [&](int i, int worker) {
        own[i] = worker + 1;
        if (arguments > 1) ++shared;
        ++done;
      });
      for (int i = 0; i < count; ++i)
        if (!own[i]) return std::exit(1);  // a task that was not run
    }
  };
  std::thread other(ask, 1);
  ask(2);
  other.join();
  std::printf("%ld tasks\n", done.load());
}
