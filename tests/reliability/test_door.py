"""Files that users hand in are read through splatproof.base.files: no pipe is waited for, no memory filled."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PLACES = (
    "reference", "methods", "datasets", "metrics", "suites", "reports", "src/splatproof/cli", "src/splatproof/api",
    "src/splatproof/base", "src/splatproof/viewing",
)  # fmt: skip
READS = re.compile(
    r"(?<!driving)\.read_(text|bytes)\(|(torch|np|json)\.load\(|np\.fromfile\(|Image\.open\(|"
    r"cv2\.imread\(|\.open\(\"rb\"\)"
)
ASKED_BEFORE = {
    "datasets/adapters/llff.py", "datasets/adapters/mega_nerf.py", "datasets/array_files.py",
    "datasets/colmap_model.py", "datasets/ingesting/survey.py", "datasets/ingesting/upright.py",
    "datasets/photos.py", "datasets/png_rows.py", "methods/storage/gltf.py", "methods/storage/packed/records.py",
    "methods/priors/roma.py", "methods/storage/packed/rows.py", "methods/storage/spz_claims.py", "metrics/lpips.py",
    "reports/store.py", "src/splatproof/base/files.py",
}  # fmt: skip
"""They ask size_of or what calls it, then read a part, or have a library read."""
OURS = {
    "datasets/ingesting/ingest.py", "datasets/procedural/exporting.py", "datasets/procedural/plan.py",
    "datasets/triangulation.py", "methods/storage/spz.py", "methods/training/snapshots.py", "reports/dashboard/assets.py",
    "reports/page.py", "src/splatproof/viewing/server.py", "suites/claim_checks/bits.py",
    "suites/claim_checks/trained.py", "suites/gallery/pictures.py", "suites/marks.py",
    "suites/studies/instructions/measure.py",
}  # fmt: skip
"""They read what the package brings, or has itself just written."""
SYSTEM = {
    "src/splatproof/base/memory.py", "suites/environment.py", "suites/studies/speed/idle.py",
}  # fmt: skip
"""They read what the system says of itself."""


def test_only_files_that_say_why_read_beside_the_door():
    found = {
        str(path.relative_to(ROOT))
        for place in PLACES
        for path in (ROOT / place).rglob("*.py")
        if READS.search(path.read_text())
    }
    assert found == ASKED_BEFORE | OURS | SYSTEM
