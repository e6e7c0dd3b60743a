"""What a paper says of two rows, and the files that hold such claims."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from splatproof.base.errors import UsageError
from splatproof.base.names import unknown
from splatproof.base.typed_toml import build, read_toml

FOLDER = Path(__file__).parent


@dataclass(frozen=True, kw_only=True)
class Claim:
    """What a paper says of two rows: `row` against `other` in one metric."""

    paper: str
    text: str
    """The claim in words, with the place where it is printed."""
    row: str
    other: str
    metric: str
    """A metric of images ("psnr", "moving_psnr") or a value of cases ("disk_mb", "render_ms")."""
    better: Literal["higher", "lower"] = "higher"
    """The side of `other` on which the paper says that `row` lies."""
    printed: float | None = None
    """The printed row - other, or with `relative` row / other - 1; None: only the direction is claimed."""
    relative: bool = False
    """Whether the effect is a ratio: sizes and times."""
    bar: float | None = None
    """The least effect, in the units of `printed` and with its sign, that is asked for in place of any;
    the claim then holds where the whole interval lies at it or on its better side."""
    scenes: tuple[str, ...] = ()
    """Scenes over which it is judged; empty: all that have runs."""
    protocol: str = ""
    """Protocol under which it is judged; empty: the only one there is."""
    missing: str = ""
    """What would be needed to test it here and is not there; empty: nothing."""

    def __post_init__(self) -> None:
        """Refuse an effect that points away from the claimed side, and a ratio that no row can reach."""
        sign = 1 if self.better == "higher" else -1
        if self.printed is not None and self.printed * sign <= 0:
            raise UsageError(f"claim {self.text!r}: printed {self.printed} is not {self.better}")
        for name in ("printed", "bar"):
            value = getattr(self, name)
            if self.relative and value is not None and value <= -1:
                raise UsageError(f"claim {self.text!r}: {name} {value}: a ratio is above -1")

    def as_effect(self, difference: float) -> float:
        """A difference of what is compared, in the units of `printed`: of a ratio row / other - 1."""
        return math.expm1(difference) if self.relative else difference

    def as_difference(self, effect: float) -> float:
        """An effect in the units of `printed` as a difference of what is compared: of logarithms."""
        return math.log1p(effect) if self.relative else effect


@dataclass(frozen=True, kw_only=True)
class ClaimFile:
    """What a file of claims holds, word by word."""

    claims: tuple[Claim, ...]


def load_claims(name: str) -> tuple[Claim, ...]:
    """The claims of a file of this folder, by its name without .toml.

    Raises: UsageError for a file that is not there or does not fit.
    """
    path = FOLDER / f"{name}.toml"
    known = sorted(path.stem for path in FOLDER.glob("*.toml"))
    if name not in known:
        raise unknown("claims", name, known)
    return build(ClaimFile, read_toml(path), str(path)).claims
