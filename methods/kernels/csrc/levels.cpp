#include "levels.hpp"

#include <cstdlib>
#include <stdexcept>

SPLAT_EACH_LEVEL(SPLAT_DECLARE_TABLE, splat::Kernels, kernels)

namespace splat {
namespace {

bool runs([[maybe_unused]] const char* level) {
#if defined(__x86_64__)
  const bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
  if (!std::strcmp(level, "avx2")) return avx2;
  if (!std::strcmp(level, "avx512"))
    return avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
           __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512bw");
#endif
  return true;  // portable anywhere, neon on every 64-bit ARM
}

std::vector<const Kernels*> levels() {
  std::vector<const Kernels*> found;
#define SPLAT_ADD(level, ...) \
  if (runs(#level)) found.push_back(&splat_kernels_##level);
  SPLAT_EACH_LEVEL(SPLAT_ADD, )
#undef SPLAT_ADD
  return found;
}

const Kernels* current = nullptr;

}  // namespace

const Kernels& kernels() { return *current; }

std::vector<std::string> simd_levels() {
  std::vector<std::string> names;
  for (const Kernels* k : levels()) names.push_back(k->name);
  return names;
}

void set_simd_level(const std::string& name) {
  std::string known;
  for (const Kernels* k : levels()) {
    if (name == k->name) {
      current = k;
      return;
    }
    known += std::string(known.empty() ? "" : ", ") + k->name;
  }
  throw std::invalid_argument("SIMD level '" + name + "' is not one that this machine has: " + known);
}

void set_simd_level_from_environment() {
  const char* name = std::getenv("SPLATPROOF_SIMD");
  set_simd_level(name && *name ? name : levels().back()->name);
}

}  // namespace splat
