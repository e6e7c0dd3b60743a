"""Fuzz the native layer under AddressSanitizer and UndefinedBehaviorSanitizer: `make fuzz`.

Builds the module with both in build/sanitized, then calls every kernel with odd sizes, strides and dtypes,
empty arrays, NaN, infinities, huge numbers and ids out of range, at every SIMD level. What is no good must end
in a ValueError, TypeError or RuntimeError; a report of a sanitizer, any other exception or scratch that is not
given back fails. Prints the seed of the failing case; `--first SEED --cases 1` repeats it.
"""

import argparse
import importlib.util
import os
import random
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).parents[2]
BUILD = ROOT / "build" / "sanitized"
SANITIZERS = "-fsanitize=address,undefined -fno-sanitize-recover=all -fno-omit-frame-pointer -g -O1"
REFUSALS = (ValueError, TypeError, RuntimeError)


def build() -> Path:
    """Configure and build the module with the sanitizers; return its file."""
    if not (BUILD / "CMakeCache.txt").exists():
        nanobind = importlib.util.find_spec("nanobind")
        if nanobind is None or nanobind.origin is None:
            sys.exit("nanobind is not installed: pip install nanobind")
        subprocess.run(
            ["cmake", "-S", ROOT, "-B", BUILD, "-DCMAKE_BUILD_TYPE=Debug",
             f"-DCMAKE_CXX_FLAGS={SANITIZERS}", "-DSPLAT_OPTIMISATION=-O1", f"-DPython_EXECUTABLE={sys.executable}",
             f"-Dnanobind_DIR={Path(nanobind.origin).parent / 'cmake'}"], check=True,
        )  # fmt: skip
    subprocess.run(["cmake", "--build", BUILD, "-j2"], check=True)
    return next((BUILD / "methods" / "kernels").glob("_ext*.so"))


def under_sanitizers(module: Path, arguments: list[str]) -> int:
    """Run this file again with the sanitizers' runtimes loaded before Python's own memory."""
    runtimes = [
        subprocess.check_output(["gcc", f"-print-file-name={name}"], text=True).strip()
        for name in ("libasan.so", "libubsan.so", "libstdc++.so")
    ]
    environment = os.environ | {
        "LD_PRELOAD": " ".join(runtimes),
        # the interpreter and torch keep memory until they end; our own is counted after each case
        "ASAN_OPTIONS": "detect_leaks=0:detect_stack_use_after_return=1:allocator_may_return_null=1",
        "UBSAN_OPTIONS": "print_stacktrace=1",
    }
    command = [sys.executable, "-P", __file__, "--module", str(module), *arguments]
    return subprocess.run(command, env=environment, check=False).returncode


def load(module: Path) -> ModuleType:
    """The sanitized module in place of the installed one."""
    spec = importlib.util.spec_from_file_location("splatproof._ext", module)
    assert spec is not None
    assert spec.loader is not None
    found = importlib.util.module_from_spec(spec)
    sys.modules["splatproof._ext"] = found
    spec.loader.exec_module(found)
    return found


def fuzz(module: Path, first: int, cases: int, seconds: float) -> None:
    """Run cases until they or the time are used up."""
    ext = load(module)
    sys.path.insert(0, str(Path(__file__).parent))
    kernel_cases = importlib.import_module("kernel_cases")
    started, done, refused = time.monotonic(), 0, 0
    for seed in range(first, first + cases):
        draw = random.Random(seed)
        level = draw.choice(ext.simd_levels())
        ext.set_simd_level(level)
        name, case = draw.choice(list(kernel_cases.CASES.items()))
        print(f"seed {seed}: {name} at {level}", file=sys.stderr, flush=True)
        try:
            case(draw)
        except REFUSALS as refusal:
            refused += 1
            if not str(refusal):
                sys.exit(f"seed {seed}: {name} refuses without a word")
        held = ext.memory()[0]
        if held:
            sys.exit(f"seed {seed}: {name} at {level} keeps {held} bytes")
        done += 1
        if time.monotonic() - started > seconds:
            break
    print(f"{done} cases, {refused} refused with an error, no report of a sanitizer")


def main() -> None:
    """Build and start again, or fuzz."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=0, help="seed of the first case")
    parser.add_argument("--cases", type=int, default=20_000)
    parser.add_argument("--seconds", type=float, default=120, help="stop after so long")
    parser.add_argument(
        "--module", type=Path, help="the built module (given to the second process)"
    )
    arguments = parser.parse_args()
    if arguments.module is None:
        sys.exit(under_sanitizers(build(), sys.argv[1:]))
    fuzz(arguments.module, arguments.first, arguments.cases, arguments.seconds)


if __name__ == "__main__":
    main()
