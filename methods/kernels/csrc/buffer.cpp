#include "buffer.hpp"

#include <pthread.h>
#include <sys/mman.h>

#include <atomic>
#include <cstdlib>
#include <mutex>
#include <vector>

namespace splat {
namespace {

constexpr size_t SMALL = 1 << 14;  // below this malloc is as good
constexpr size_t PAGE = 1 << 21;   // large pages: rows are read in the order of depth, which small ones make slow
constexpr unsigned KEEP = 200;     // requests after which a block that nobody wanted goes back to the system
// Bytes that are kept at once: a step at 4000 x 3000 has used 725 MB, in sizes that change from view to view.
constexpr size_t MOST_IDLE = (size_t)1 << 29;

struct Idle {
  void* memory;
  size_t bytes;
  unsigned since;
};

std::mutex mutex;
std::vector<Idle> idle;
unsigned requests = 0;
size_t idle_bytes = 0;
std::atomic<size_t> held{0}, peak{0};

void count_up(size_t bytes) {
  const size_t now = held += bytes;
  for (size_t most = peak; now > most && !peak.compare_exchange_weak(most, now);) {}
}

// A fork while another thread holds the mutex would leave it locked in the child for good.
[[maybe_unused]] const int at_fork = pthread_atfork([] { mutex.lock(); }, [] { mutex.unlock(); }, [] { mutex.unlock(); });

// Sizes in steps of an eighth, so that a model that grows a little finds its old blocks.
size_t rounded(size_t bytes) {
  size_t step = 64;
  while (step * 16 <= bytes) step *= 2;
  return (bytes + step - 1) / step * step;
}

}  // namespace

void* take_memory(size_t bytes) {
  bytes = rounded(bytes ? bytes : 1);
  if (bytes >= SMALL) {
    std::lock_guard<std::mutex> lock(mutex);
    ++requests;
    void* found = nullptr;
    size_t kept = 0;
    for (const Idle& block : idle) {
      if (!found && block.bytes == bytes) found = block.memory;
      else if (requests - block.since > KEEP) std::free(block.memory);
      else {
        idle[kept++] = block;
        continue;
      }
      idle_bytes -= block.bytes;
    }
    idle.resize(kept);
    if (found) {
      count_up(bytes);
      return found;
    }
  }
  const bool large = bytes >= 2 * PAGE;
  void* memory = nullptr;  // aligned_alloc may refuse sizes that are no multiple of the alignment
  if (posix_memalign(&memory, large ? PAGE : 64, bytes)) throw std::bad_alloc();
  if (large) madvise(memory, bytes / PAGE * PAGE, MADV_HUGEPAGE);  // a wish: nothing depends on it
  count_up(bytes);
  return memory;
}

void give_memory(void* memory, size_t bytes) {
  if (!memory) return;
  bytes = rounded(bytes ? bytes : 1);
  held -= bytes;
  if (bytes < SMALL || bytes > MOST_IDLE) {
    std::free(memory);
    return;
  }
  std::lock_guard<std::mutex> lock(mutex);
  size_t oldest = 0;
  for (; idle_bytes + bytes > MOST_IDLE; ++oldest) {
    std::free(idle[oldest].memory);
    idle_bytes -= idle[oldest].bytes;
  }
  idle.erase(idle.begin(), idle.begin() + oldest);
  idle.push_back({memory, bytes, requests});
  idle_bytes += bytes;
}

Memory memory_in_use() {
  std::lock_guard<std::mutex> lock(mutex);
  return {held, peak, idle_bytes};
}

void forget_peak() { peak = held.load(); }

}  // namespace splat
