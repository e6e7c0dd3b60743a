// The SIMD levels of this build, and which one is in use. Each family of kernels has one table of functions a level.
#pragma once
#include <cstring>
#include <string>
#include <vector>

#include "types.hpp"

// with(level, ...) for each level that this build has, slowest first.
#if defined(__x86_64__)
#define SPLAT_EACH_LEVEL(with, ...) with(portable, __VA_ARGS__) with(avx2, __VA_ARGS__) with(avx512, __VA_ARGS__)
#elif defined(__aarch64__)
#define SPLAT_EACH_LEVEL(with, ...) with(portable, __VA_ARGS__) with(neon, __VA_ARGS__)
#else
#define SPLAT_EACH_LEVEL(with, ...) with(portable, __VA_ARGS__)
#endif

#define SPLAT_DECLARE_TABLE(level, type, family) extern const type splat_##family##_##level;
#define SPLAT_PICK_TABLE(level, type, family) \
  if (!std::strcmp(splat::kernels().name, #level)) return ::splat_##family##_##level;

// Declares the tables of a family, and the function FAMILY_in_use() that picks among them; in the global namespace.
#define SPLAT_TABLES(type, family)                         \
  SPLAT_EACH_LEVEL(SPLAT_DECLARE_TABLE, type, family)      \
  static const type& family##_in_use() {                   \
    SPLAT_EACH_LEVEL(SPLAT_PICK_TABLE, type, family)       \
    return splat_##family##_portable;                      \
  }

namespace splat {

const Kernels& kernels();  // of the level in use

// Levels that this machine can run, slowest first.
std::vector<std::string> simd_levels();

// Use that level from now on. Throws std::invalid_argument where the machine does not have it.
void set_simd_level(const std::string& name);

// Use the level that the variable SPLATPROOF_SIMD names, else the fastest. Throws as set_simd_level does.
void set_simd_level_from_environment();

}  // namespace splat
