"""Entry points of other packages: found, and refused with the package's name where they are wrong."""

from importlib.metadata import EntryPoint

import pytest

from splatproof.base import plugins
from splatproof.base.errors import UsageError

GROUP = "splatproof.test"


@pytest.fixture
def offered(monkeypatch):
    """Pretends that installed packages offer entry points."""

    def offer(**values: str) -> None:
        points = [EntryPoint(name=name, value=value, group=GROUP) for name, value in values.items()]
        monkeypatch.setattr(
            plugins, "entry_points", lambda group: [p for p in points if p.group == group]
        )

    return offer


def test_what_a_package_adds_stands_beside_what_is_built_in(offered):
    offered(pi="math:pi", e="math:e")
    assert plugins.with_plugins({"one": 1.0}, GROUP, float) == {
        "one": 1.0, "e": 2.718281828459045, "pi": 3.141592653589793,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("math:nothing", "cannot be loaded"),
        ("no_such_module:x", "cannot be loaded"),
        ("math:cos", "is a builtin"),
    ],
)
def test_what_cannot_be_used_is_named(offered, value, said):
    offered(odd=value)
    with pytest.raises(UsageError, match=said) as caught:
        plugins.with_plugins({}, GROUP, float)
    assert "odd = " in str(caught.value)


def test_a_taken_name_is_refused(offered):
    offered(one="math:pi")
    with pytest.raises(UsageError, match="the name is taken"):
        plugins.with_plugins({"one": 1.0}, GROUP, float)
