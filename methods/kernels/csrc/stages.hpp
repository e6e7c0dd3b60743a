// Wall seconds of each stage of the last render and of the last backward pass of this process: for the speed
// study, which holds every stage against what the machine could do.
#pragma once
#include <atomic>
#include <chrono>

namespace splat {

enum Stage { STAGE_PROJECT, STAGE_BIN, STAGE_BLEND, STAGE_BLEND_BACKWARD, STAGE_PROJECT_BACKWARD, STAGES };

inline std::atomic<double> stage_seconds[STAGES];

class StageClock {
 public:
  // The time since the last lap, or since the clock was made, belongs to `stage`.
  void lap(Stage stage) {
    const auto now = std::chrono::steady_clock::now();
    stage_seconds[stage].store(std::chrono::duration<double>(now - last_).count(), std::memory_order_relaxed);
    last_ = now;
  }

 private:
  std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
};

}  // namespace splat
