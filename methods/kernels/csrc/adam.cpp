#include "adam.hpp"

#include <algorithm>
#include <cmath>

#include "pool.hpp"
#include "render.hpp"

namespace splat {

void adam_step(const std::vector<AdamGroup>& groups, int64_t step, double beta1, double beta2, double epsilon,
               const uint8_t* rows, int threads) {
  constexpr int64_t FLOATS_A_TASK = 1 << 14;
  struct Task {
    const AdamGroup* group;
    int64_t first, last;  // rows
  };
  std::vector<Task> tasks;
  for (const AdamGroup& g : groups) {
    if (g.width == 0) continue;
    const int64_t piece = std::max<int64_t>(1, FLOATS_A_TASK / g.width);
    for (int64_t i = 0; i < g.rows; i += piece) tasks.push_back({&g, i, std::min(g.rows, i + piece)});
  }
  const Kernels& k = kernels();
  const double first_part = 1 - std::pow(beta1, (double)step), correction = 1 - std::pow(beta2, (double)step);
  parallel(threads, (int)tasks.size(), [&](int i, int) {
    const Task& task = tasks[i];
    const AdamGroup& g = *task.group;
    const AdamRate rate = {(float)(1 - beta1), (float)beta2, (float)(1 - beta2), (float)(1 / std::sqrt(correction)),
                           (float)(g.rate / first_part), (float)epsilon};
    for (int64_t row = task.first; row < task.last;) {  // runs of rows that are chosen
      int64_t end = row;
      while (end < task.last && (!rows || rows[end])) ++end;
      if (end > row) k.adam(rate, g.tensor, row * g.width, end * g.width);
      row = end + 1;
    }
  });
}

}  // namespace splat
