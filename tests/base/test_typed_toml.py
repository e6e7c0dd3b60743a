"""TOML tables as dataclasses: what is taken, and what is refused in one line."""

from dataclasses import dataclass, field

import pytest

from splatproof.base.errors import DataError, SplatproofError, UsageError
from splatproof.base.typed_toml import build, read_toml


@dataclass(frozen=True)
class Inner:
    """A table in a table."""

    rate: float = 1.0


@dataclass(frozen=True)
class Outer:
    """A file."""

    name: str
    inner: Inner = field(default_factory=Inner)
    sizes: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """Check."""
        if self.name == "bad":
            raise UsageError("name is bad")


def test_tables_become_dataclasses(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text('name = "x"\nsizes = [1, 2]\n[inner]\nrate = 2\n')
    assert build(Outer, read_toml(path), str(path)) == Outer("x", Inner(2.0), (1, 2))


@pytest.mark.parametrize("fault", [UsageError, DataError])
@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", "a.toml: name is missing"),
        (
            'name = "x"\nsize = [1]',
            "a.toml: unknown 'size', did you mean 'sizes'. There are: inner",
        ),
        ('name = "x"\ninner = { rat = 1 }', "a.toml: inner: unknown 'rat', did you mean 'rate'"),
        ('name = "x"\nsizes = [true]', r"sizes\[0\]: .*found True"),
        ("name = 3", "a.toml: name: .*found 3"),
        ('name = "bad"', "a.toml: name is bad"),
        ("name =", "a.toml: not a TOML file"),
    ],
)
def test_every_mistake_is_named_with_its_file(tmp_path, text, match, fault):
    path = tmp_path / "a.toml"
    path.write_text(text)
    with pytest.raises(SplatproofError, match=match) as caught:
        build(Outer, read_toml(path, fault), str(path), fault)
    assert type(caught.value) is fault
    assert "\n" not in str(caught.value)


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(UsageError, match="a.toml: no such file"):
        read_toml(tmp_path / "a.toml")
