"""Fuzz the native layer under AddressSanitizer and UndefinedBehaviorSanitizer, or under ThreadSanitizer: `make fuzz`.

Builds the module with them in build/sanitized or build/thread_sanitized, then calls every kernel with odd sizes, strides and dtypes,
empty arrays, NaN, infinities, huge numbers and ids out of range, at every SIMD level. What is no good must end
in a ValueError, TypeError or RuntimeError; a report of a sanitizer, any other exception or scratch that is not
given back fails. With `--kind threads` the kernels run on 2 to 7 threads, and two Python threads call them at once;
only what our own code does counts, for torch and the interpreter are not instrumented. Prints the seed of the failing case; `--first SEED --cases 1` repeats it.
"""

import argparse
import importlib.util
import os
import random
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).parents[2]
DEBUG = "-fno-omit-frame-pointer -g -O1"
RACE = 66
"""Exit code of a process in which two threads raced."""


@dataclass(frozen=True, kw_only=True)
class Kind:
    """What is looked for, and how a process is started for it."""

    folder: str
    """Folder of the build below build/."""
    flags: str
    """Flags of the compiler."""
    runtimes: tuple[str, ...]
    """Libraries that are loaded before Python's own memory."""
    options: dict[str, str]
    """Environment of the process."""


KINDS = {
    "memory": Kind(
        folder="sanitized", runtimes=("libasan.so", "libubsan.so", "libstdc++.so"),
        flags=f"-fsanitize=address,undefined -fno-sanitize-recover=all {DEBUG}",
        options={
            # the interpreter and torch keep memory until they end; our own is counted after each case
            "ASAN_OPTIONS": "detect_leaks=0:detect_stack_use_after_return=1:allocator_may_return_null=1",
            "UBSAN_OPTIONS": "print_stacktrace=1",
        },
    ),
    "threads": Kind(
        folder="thread_sanitized", runtimes=("libtsan.so", "libstdc++.so"), flags=f"-fsanitize=thread {DEBUG}",
        options={
            "TSAN_OPTIONS": f"ignore_noninstrumented_modules=1:halt_on_error=1:exitcode={RACE}",
            "OMP_NUM_THREADS": "1",  # how torch's own threads wait for each other cannot be seen
        },
    ),
}  # fmt: skip
REFUSALS = (ValueError, TypeError, RuntimeError)


def build(kind: Kind) -> Path:
    """Configure and build the module with the sanitizers; return its file."""
    folder = ROOT / "build" / kind.folder
    if not (folder / "CMakeCache.txt").exists():
        nanobind = importlib.util.find_spec("nanobind")
        if nanobind is None or nanobind.origin is None:
            sys.exit("nanobind is not installed: pip install nanobind")
        subprocess.run(
            ["cmake", "-S", ROOT, "-B", folder, "-DCMAKE_BUILD_TYPE=Debug",
             f"-DCMAKE_CXX_FLAGS={kind.flags}", "-DSPLAT_OPTIMISATION=-O1", f"-DPython_EXECUTABLE={sys.executable}",
             f"-Dnanobind_DIR={Path(nanobind.origin).parent / 'cmake'}"], check=True,
        )  # fmt: skip
    subprocess.run(["cmake", "--build", folder, "-j2"], check=True)
    return next((folder / "methods" / "kernels").glob("_ext*.so"))


def under_sanitizers(kind: Kind, module: Path, arguments: list[str]) -> int:
    """Run this file again with the sanitizers' runtimes loaded before Python's own memory."""
    runtimes = [
        subprocess.check_output(["gcc", f"-print-file-name={name}"], text=True).strip()
        for name in kind.runtimes
    ]
    environment = os.environ | kind.options | {"LD_PRELOAD": " ".join(runtimes)}
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


def refuses(case: Callable[[random.Random], None], draw: random.Random) -> bool:
    """Whether a case ends in an error with words.

    Args:
        case: One of kernel_cases.
        draw: What it draws from.
    """
    try:
        case(draw)
    except REFUSALS as refusal:
        if not str(refusal):
            raise AssertionError("refused without a word") from refusal
        return True
    return False


def fuzz(module: Path, first: int, cases: int, seconds: float, *, crowded: bool) -> None:
    """Run cases until they or the time are used up.

    Args:
        module: The sanitized module.
        first: Seed of the first case.
        cases: How many at the most.
        seconds: For so long at the most.
        crowded: Two of a case at once, each on several threads.
    """
    ext = load(module)
    sys.path.insert(0, str(Path(__file__).parent))
    kernel_cases = importlib.import_module("kernel_cases")
    use_threads, callers = ext.set_threads, 2 if crowded else 1
    if crowded:
        vars(ext)["set_threads"] = lambda count: None  # wrappers ask for torch's number
    started, done, refused = time.monotonic(), 0, 0
    with ThreadPoolExecutor(callers) as pool:
        for seed in range(first, first + cases):
            draw = random.Random(seed)
            level = draw.choice(ext.simd_levels())
            ext.set_simd_level(level)
            name, case = draw.choice(list(kernel_cases.CASES.items()))
            print(f"seed {seed}: {name} at {level}", file=sys.stderr, flush=True)
            if crowded:
                use_threads(draw.randint(2, 7))
            draws = [draw, *(random.Random(-seed - 1) for _ in range(callers - 1))]
            refused += sum(pool.map(refuses, [case] * callers, draws))
            held = ext.memory()[0]
            if held:
                sys.exit(f"seed {seed}: {name} at {level} keeps {held} bytes")
            done += callers
            if time.monotonic() - started > seconds:
                break
    print(f"{done} cases, {refused} refused with an error, no report of a sanitizer")


def main() -> None:
    """Build and start again, or fuzz."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kind", choices=KINDS, default="memory", help="what is looked for")
    parser.add_argument("--first", type=int, default=0, help="seed of the first case")
    parser.add_argument("--cases", type=int, default=20_000)
    parser.add_argument("--seconds", type=float, default=120, help="stop after so long")
    parser.add_argument(
        "--module", type=Path, help="the built module (given to the second process)"
    )
    told = parser.parse_args()
    kind = KINDS[told.kind]
    if told.module is None:
        sys.exit(under_sanitizers(kind, build(kind), sys.argv[1:]))
    fuzz(told.module, told.first, told.cases, told.seconds, crowded=told.kind == "threads")


if __name__ == "__main__":
    main()
