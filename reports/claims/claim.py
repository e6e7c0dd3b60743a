"""What is claimed of two rows of a suite, or of a check, and the files that hold such claims."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from splatproof.base.errors import UsageError
from splatproof.base.names import unknown
from splatproof.base.typed_toml import build, read_toml
from splatproof.reports.claims.printed import Cells, Numbers, effect_of, source_of

FOLDER = Path(__file__).parent
HOUSE = "house"
"""What stands for a paper where the claim is this project's own."""
Side = Literal["higher", "lower"]


@dataclass(frozen=True, kw_only=True)
class Claim:
    """What a paper says of two rows: `row` against `other` in one metric."""

    paper: str
    """As in the published numbers; HOUSE: this project's own."""
    text: str
    """The claim in words."""
    suite: str = ""
    """Suite that has the rows; a file may say it for all of its claims."""
    row: str
    other: str = ""
    """Empty: the row's own value is judged, by the bar."""
    metric: str
    """A metric of images ("psnr", "moving_psnr") or a value of cases ("disk_mb", "render_ms")."""
    better: Side = "higher"
    """The side of `other` on which the paper says that `row` lies."""
    cells: Cells | None = None
    """Where the effect is printed; None: nothing is, or `where` says the place."""
    where: str = ""
    """Place of a claim without printed cells: a section of the paper."""
    printed: float | None = None
    """The printed row - other, or with `relative` row / other - 1; None: only the direction is claimed.
    Files do not hold it: it is computed from `cells`."""
    source: str = ""
    """Table and printed cells in words, made of `cells`."""
    relative: bool = False
    """Whether the effect is a ratio: sizes and times."""
    bar: float | None = None
    """The least effect, in the units of `printed` and with its sign, that is asked for in place of any;
    the claim then holds where the whole interval lies at it or on its better side."""
    no_more: bool = False
    """Whether the printed effect is a loss of which no more is claimed: it is the bar then. A table that shows how little noise
    costs is not borne out by noise that costs more."""
    scenes: tuple[str, ...] = ()
    """Scenes over which it is judged; empty: all that have runs."""
    protocol: str = ""
    """Protocol under which it is judged; empty: the only one there is."""
    before_training: bool = False
    """Whether the metric is settled before training: partitions of points and views."""
    fixed_length: bool = False
    """Whether it is about rows of just these lengths, as one of equal time is: what further steps would
    change is not asked then."""
    visits: int = 0
    """Fewest times that training has to visit each of its photos; rows that are known to visit one fewer times are
    too short. A file may say it for all of its claims. 0: it is not asked."""
    missing: str = ""
    """What would be needed to test it here, is not there, and cannot be read off the suite and the
    methods; empty: nothing."""

    def __post_init__(self) -> None:
        """Refuse an effect that points away from the claimed side, and a ratio that no row can reach."""
        sign = 1 if self.better == "higher" else -1
        if self.printed is not None and self.printed * sign <= 0:
            raise UsageError(f"claim {self.text!r}: printed {self.printed} is not {self.better}")
        for name in ("printed", "bar"):
            value = getattr(self, name)
            if self.relative and value is not None and value <= -1:
                raise UsageError(f"claim {self.text!r}: {name} {value}: a ratio is above -1")
        if not self.other and (self.bar is None or self.relative):
            raise UsageError(f"claim {self.text!r}: without another row it needs a bar, no ratio")

    @property
    def rows(self) -> tuple[str, ...]:
        """The rows that it compares, or the one that it looks at."""
        return (self.row, self.other) if self.other else (self.row,)

    def as_effect(self, difference: float) -> float:
        """A difference of what is compared, in the units of `printed`: of a ratio row / other - 1."""
        return math.expm1(difference) if self.relative else difference

    def as_difference(self, effect: float) -> float:
        """An effect in the units of `printed` as a difference of what is compared: of logarithms."""
        return math.log1p(effect) if self.relative else effect

    def shown(self, effect: float) -> str:
        """An effect as tables show it: per cent for a ratio, three digits for anything else."""
        if self.relative:
            return f"{100 * effect:+.0f} %"
        return f"{effect:+.3g}" if self.other else f"{effect:.3g}"


@dataclass(frozen=True, kw_only=True)
class CheckClaim:
    """What this project claims of itself and a check measures."""

    text: str
    """The claim in words."""
    check: str
    """Name of the check that measures it."""
    better: Side
    """Side of the bar on which the measured values have to lie."""
    bar: float
    by: Literal["every", "median"] = "every"
    """every: each measured value reaches the bar (counts and errors, which repeat); median: the 95 %
    interval of the median does (times, which scatter)."""
    missing: str = ""
    """What would be needed to test it here and is not there; empty: nothing."""


@dataclass(frozen=True, kw_only=True)
class ClaimFile:
    """What a file of claims holds, word by word."""

    suite: str = ""
    """Suite of the claims that name none."""
    visits: int = 0
    """That of the claims that name none."""
    claims: tuple[Claim, ...] = ()
    checks: tuple[CheckClaim, ...] = ()


def claim_files() -> list[str]:
    """Names of the files of claims that come with the package, sorted."""
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def load_claims(name: str, numbers: Numbers) -> tuple[Claim, ...]:
    """The claims of a file of this folder with their printed effects.

    Args:
        name: Name of the file without .toml.
        numbers: Every published value, as `splatproof.suites.published.rows.numbers` gives them.
    Raises: UsageError for a file that is not there or does not fit, and for printed cells that are not
        among the numbers.
    """
    file, path = _read(name)
    where = str(path)
    return tuple(_bound(one, file, numbers, where) for one in file.claims)


def load_checks(name: str) -> tuple[CheckClaim, ...]:
    """The claims of a file that checks measure. Raises: UsageError as `load_claims`."""
    return _read(name)[0].checks


def all_claims(numbers: Numbers) -> tuple[tuple[Claim, ...], tuple[CheckClaim, ...]]:
    """The claims of all files, and those that checks measure, in the order of `claim_files`.

    Args:
        numbers: See `load_claims`.
    """
    names = claim_files()
    claims = tuple(claim for name in names for claim in load_claims(name, numbers))
    return claims, tuple(check for name in names for check in load_checks(name))


def _read(name: str) -> tuple[ClaimFile, Path]:
    path = FOLDER / f"{name}.toml"
    if name not in claim_files():
        raise unknown("claims", name, claim_files())
    return build(ClaimFile, read_toml(path), str(path)), path


def _bound(
    claim: Claim, file: ClaimFile, numbers: Sequence[Mapping[str, str]], where: str
) -> Claim:
    """The claim with what its file says for all, and with the effect that the paper prints."""
    place = f"{where}: claim {claim.text!r}"
    if claim.printed is not None or claim.source:
        raise UsageError(f"{place}: printed and source are computed; name the cells instead")
    if claim.paper != HOUSE and (claim.cells is None) == (not claim.where):
        raise UsageError(f"{place}: expected cells of a table, or where it is said, and not both")
    named = replace(claim, suite=claim.suite or file.suite, visits=claim.visits or file.visits)
    if not named.suite:
        raise UsageError(f"{place}: suite is missing, in the claim and in the file")
    if claim.no_more and (claim.cells is None or claim.bar is not None):
        raise UsageError(f"{place}: no_more takes the printed cells for its bar; name these alone")
    if claim.cells is None:
        return replace(named, source=claim.where)
    per_second = claim.metric == "render_ms"
    effect = effect_of(claim.paper, claim.cells, claim.relative, per_second, numbers, place)
    source = source_of(claim.paper, claim.cells, numbers, place)
    if claim.no_more:
        return replace(named, bar=effect, source=source)
    return replace(named, printed=None if claim.bar is not None else effect, source=source)
