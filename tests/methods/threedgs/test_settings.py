"""Settings that no run can follow are refused in one line; schedules have the release's values."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatproof.base.errors import MissingError, UsageError
from splatproof.methods.contracts.backends import CONTRACT, describe_backends, get_backend
from splatproof.methods.registry import METHODS, get_method
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density
from splatproof.methods.training.schedules import Rates, active_degree, log_linear, settling, shrink


@pytest.mark.parametrize(
    ("kind", "setting"),
    [
        (Settings, {"iterations": 0}),
        (Settings, {"sh_degree": 4}),
        (Settings, {"sh_interval": -1}),
        (Settings, {"initial_opacity": 1.0}),
        (Settings, {"dssim": 1.5}),
        (Rates, {"opacity_logits": -1.0}),
        (Rates, {"means": math.nan}),
        (Density, {"interval": 0}),
        (Density, {"gradient": -1e-4}),
        (Density, {"least_opacity": 1.0}),
        (Density, {"most": 0}),
    ],
)
def test_wrong_settings_are_named(kind, setting):
    (name,) = setting
    with pytest.raises(UsageError, match=rf"{name} is .*, expected") as error:
        kind(**setting)
    assert "\n" not in str(error.value)


def test_unknown_names_get_the_nearest():
    with pytest.raises(UsageError, match="did you mean '3dgs'"):
        get_method("3gds")
    with pytest.raises(UsageError, match="did you mean 'reference'"):
        get_backend("refrence")


def test_backends_say_what_is_missing():
    for backend in describe_backends():
        assert backend.capabilities <= CONTRACT
        if backend.missing:
            with pytest.raises(MissingError, match=backend.name):
                get_backend(backend.name)
            with pytest.raises(MissingError, match=backend.name):
                backend.rasterize()
        else:
            assert get_backend(backend.name).name == backend.name


def test_every_method_has_defaults():
    for name, method in METHODS.items():
        assert method.name == name
        settings = method.settings()
        assert getattr(settings, "iterations", None) or settings.seconds > 0


@given(step=st.integers(0, 40_000))
def test_rate_of_means_falls_log_linearly_to_the_last_and_stays(step):
    rate = log_linear(Rates().means, Rates().means_final, factor=2.0)(step, 30_000) / 2
    want = 1.6e-4 * 0.01 ** min(1.0, step / 30_000)
    assert rate == pytest.approx(want, rel=1e-12)


def test_a_rate_of_zero_freezes():
    assert log_linear(0.0, 1e-6)(5, 10) == 0


def test_other_rates_settle_in_the_second_half():
    assert [settling(1.0)(step, 100) for step in (1, 100)] == [1, 1]
    factors = [settling(1.0, 0.01)(step, 100) for step in (1, 50, 75, 100)]
    assert factors == pytest.approx([1, 1, 0.1, 0.01])


def test_degrees_come_one_by_one():
    assert [active_degree(step, 1000.0, 3) for step in (1, 999, 1000, 2999, 3000, 9000)] == [
        0, 0, 1, 2, 3, 3,
    ]  # fmt: skip
    assert active_degree(1, 0.0, 3) == 3


def test_schedules_shrink_but_never_stretch():
    assert [shrink(n) for n in (3000, 30_000, 60_000)] == [0.1, 1, 1]
