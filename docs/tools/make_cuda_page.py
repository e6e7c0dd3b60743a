"""Make docs/cuda.md: python docs/tools/make_cuda_page.py [RUNS/speed.jsonl]

From the rows that `bench study speed --quick --backend cuda --out RUNS` has written on a machine with a GPU, which
are kept in docs/cuda.json with what the GPU and its software are; run there. Without rows the page is written again
from that file.
"""

import importlib.metadata
import json
import sys
from pathlib import Path
from typing import Any

import torch

DOCS = Path(__file__).resolve().parents[1]
ROWS, PAGE = DOCS / "cuda.json", DOCS / "cuda.md"
KEPT = (
    "component", "twin", "case", "forward_ms", "backward_ms", "device_mb", "disturbed_percent",
    "max_abs_error", "grad_rel_l2", "ok",
)  # fmt: skip
GPU = ("cuda adapter", "gsplat's own call")
CPU = ("cpu avx512", "cpu")
"""What the CPU's rows of the two components are called."""
TEXT = """# The backend `cuda` on a GPU

Made by `python docs/tools/make_cuda_page.py RUNS/speed.jsonl` from the rows of
`bench study speed --quick --backend cuda --out RUNS` on a machine with a GPU (here in [cuda.json](cuda.json)); a test
compares; the machine's name and versions were written in from what its commands printed. There `pytest tests/methods/contracts/test_cuda_device.py` holds gsplat's pictures and gradients against the
float64 reference, and trains 3dgs, absgs, mip-splatting, scaffold-gs, pvg and hdgs on both; without a GPU it is
skipped and says so.

{machine}.

`cuda adapter` is the backend behind our signature, `gsplat's own call` the same rasterizer called directly with
tensors that are on the GPU already, `cpu` ours on the processor of that machine. Milliseconds forward and backward
are medians of interleaved runs, the GPU waited for. **The processor was busy** with other work (fourteen of its
sixteen cores), so its times are upper bounds and no ratio is given. Errors are against the float64 reference on
the smallest case and do not depend on that.

{table}

- The GPU's gradients are a hundred times further from float64 than the CPU's and well within the budget (1e-3).
- Pictures this small do not fill a GPU: its time hardly grows from 1,000 to 20,000 Gaussians. The busy CPU was ahead only
  at 1,000 Gaussians on 64x48.
"""


def read_rows(path: Path) -> dict[str, Any]:
    """The rows of rasterizer and pipeline, and this machine.

    Args:
        path: What the study has written, a JSON object a line.
    """
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return {
        "machine": {
            "GPU": torch.cuda.get_device_name(),
            "gsplat": importlib.metadata.version("gsplat"), "torch": torch.__version__,
        },
        "rows": [
            {key: row[key] for key in KEPT}
            for row in rows if row["component"] in ("rasterizer", "pipeline") and row["twin"] in (*GPU, *CPU)
        ],
    }  # fmt: skip


def page() -> str:
    """The page of the committed rows."""
    known = json.loads(ROWS.read_text(encoding="utf-8"))
    timed = {row["case"] for row in known["rows"] if row["twin"] in GPU}
    heads = (
        "what", "Gaussians, pixels", "by", "forward ms", "backward ms", "colour error", "gradient error", "GPU MB",
    )  # fmt: skip
    lines = ["| " + " | ".join(heads) + " |", "|---|---|---" + "|---:" * (len(heads) - 3) + "|"]
    lines += [
        f"| {row['component']} | {row['case']} | {row['twin']} | {row['forward_ms']:.2f} | {row['backward_ms']:.2f} "
        f"| {row['max_abs_error']:.1e} | {row['grad_rel_l2']:.1e} | "
        + (f"{row['device_mb']:.0f} |" if row["device_mb"] else "|")
        for row in known["rows"] if row["case"] in timed
    ]  # fmt: skip
    machine = ", ".join(f"{name} {value}" for name, value in known["machine"].items())
    return TEXT.format(machine=machine, table="\n".join(lines))


if __name__ == "__main__":
    if len(sys.argv) > 1:
        ROWS.write_text(json.dumps(read_rows(Path(sys.argv[1])), indent=1) + "\n", encoding="utf-8")
    PAGE.write_text(page(), encoding="utf-8")
