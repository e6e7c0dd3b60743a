// Memory without initialisation, aligned for vectors. What is given back is kept for the next request of that
// size for a while, because fresh pages from the system cost more than most of what is computed in them.
#pragma once
#include <cstddef>
#include <new>

namespace splat {

void* take_memory(size_t bytes);  // throws std::bad_alloc
void give_memory(void* memory, size_t bytes);

struct Memory {
  size_t held, peak, idle;  // bytes in use now, most in use at once, kept for later
};
Memory memory_in_use();
void forget_peak();  // the most in use starts again at what is in use now

template <class T>
class Buffer {
 public:
  Buffer() = default;
  explicit Buffer(size_t count) { resize(count); }
  Buffer(const Buffer&) = delete;
  Buffer& operator=(const Buffer&) = delete;
  ~Buffer() { give_memory(data_, capacity_ * sizeof(T)); }

  // Contents are lost when it grows.
  void resize(size_t count) {
    if (count > capacity_) {
      give_memory(data_, capacity_ * sizeof(T));
      data_ = nullptr;
      capacity_ = 0;
      data_ = static_cast<T*>(take_memory(count * sizeof(T)));
      capacity_ = count;
    }
    count_ = count;
  }
  T* data() { return data_; }
  const T* data() const { return data_; }
  size_t size() const { return count_; }
  size_t bytes() const { return capacity_ * sizeof(T); }
  T& operator[](size_t i) { return data_[i]; }
  const T& operator[](size_t i) const { return data_[i]; }

 private:
  T* data_ = nullptr;
  size_t count_ = 0, capacity_ = 0;
};

}  // namespace splat
