import dataclasses
import json
import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatproof.base.errors import DataError
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.result import ImageScore, Result
from splatproof.reference.types.result_json import (
    NON_FINITE,
    RULES,
    result_from_json,
    result_to_json,
)

names = st.text(max_size=12).filter(lambda text: text not in NON_FINITE)
numbers = st.floats(allow_nan=True, allow_infinity=True)
free = st.recursive(
    st.none() | st.booleans() | st.integers() | numbers | names,
    lambda inner: (
        st.lists(inner, max_size=3).map(tuple) | st.dictionaries(names, inner, max_size=3)
    ),
    max_leaves=8,
)
table = st.dictionaries(names, numbers, max_size=4)
image = st.fixed_dictionaries(
    {"name": names, "truth_sha256": names, "valid_share": numbers, "metrics": table}
)
texts = ("suite", "scene", "method", "protocol", "split_sha256", "model_sha256", "error")
counts = ("seed", "primitives", "bytes_on_disk")
sizes = ("cpu_seconds", "peak_memory_mb", "render_ms")
# drawn as dicts: the run-time type check of a Result uses `random`, which strategies must not
fields = st.fixed_dictionaries(
    dict.fromkeys(texts, names)
    | dict.fromkeys(counts, st.integers())
    | dict.fromkeys(sizes, numbers)
    | dict.fromkeys(("metrics", "stages"), table)
    | dict.fromkeys(("protocol_rules", "settings"), st.dictionaries(names, free, max_size=3))
    | {"counters": st.dictionaries(names, st.integers(), max_size=3)}
    | dict.fromkeys(("environment", "scene_facts"), st.dictionaries(names, names, max_size=2))
    | {
        "images": st.lists(image, max_size=3),
        "curve": st.lists(st.tuples(st.integers(), table), max_size=3).map(tuple),
        "curve_seconds": st.lists(st.floats(allow_nan=False), max_size=3).map(tuple),
        "left_out": st.lists(st.tuples(names, names), max_size=2).map(tuple),
        "suite_scenes": st.lists(names, max_size=2).map(tuple),
    }
)


def a_result() -> Result:
    score = ImageScore(name="a", truth_sha256="0", valid_share=1.0, metrics={"psnr": math.inf})
    return Result(
        suite="quick", scene="s", method="m", seed=0, protocol="p", protocol_rules={},
        settings={"rate": 0.1, "far": math.inf, "sizes": (1, 2)}, images=(score,),
        metrics={"psnr": math.nan}, stages={"train": 1.0}, cpu_seconds=1.0, peak_memory_mb=1.0,
        primitives=1, bytes_on_disk=1, render_ms=1.0, split_sha256="0", model_sha256="0",
        curve=((1, {"loss": 0.5}),), left_out=(("b.jpg", "not registered"),),
    )  # fmt: skip


@settings(deadline=None, max_examples=25)
@given(drawn=fields)
def test_round_trip_is_exact(drawn: dict[str, Any]):
    images = tuple(ImageScore(**image) for image in drawn["images"])
    others = {name: value for name, value in drawn.items() if name != "images"}
    result = Result(images=images, **others)
    line = result_to_json(result)
    assert "\n" not in line
    back = result_from_json(line, "record.json")
    known = dataclasses.replace(
        result, protocol_rules=result.protocol_rules | RULES | result.protocol_rules
    )
    # repr, because nan != nan and because 1 == 1.0 == True
    assert repr(back) == repr(known)


def test_a_record_from_before_a_rule_was_made_by_its_default():
    rules = dataclasses.asdict(Protocol(name="p", source="ours", width=240))
    older = {name: rule for name, rule in rules.items() if name not in ("max_width", "hold")}
    for stored in (older, rules):
        assert result_from_json(changed(protocol_rules=stored), "r").protocol_rules == rules


def test_a_record_from_before_work_was_counted_has_no_counters():
    older = json.loads(result_to_json(a_result()))
    del older["counters"]
    assert result_from_json(json.dumps(older), "r") == result_from_json(changed(), "r")
    assert result_from_json(changed(counters={"pairs": 3}), "r").counters == {"pairs": 3}
    with pytest.raises(DataError, match="counters.pairs: expected int, found float"):
        result_from_json(changed(counters={"pairs": 3.5}), "r")


def test_every_field_stands_under_its_own_name():
    record = json.loads(result_to_json(a_result()))
    assert list(record) == ["version", *(field.name for field in dataclasses.fields(Result))]
    assert record["metrics"]["psnr"] == "NaN"


def changed(**changes: object) -> str:
    record = json.loads(result_to_json(a_result())) | changes
    return json.dumps({key: value for key, value in record.items() if value != "DROP"})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not a result record"),
        ("[]", "expected a JSON object, found list"),
        ('{"version": 1, "seed": NaN}', "NaN is not JSON"),
        (changed(version=2), "record version 2, expected 1"),
        (changed(version=True), "record version True, expected 1"),
        (changed(version="DROP"), "record version None"),
        (changed(seed="DROP"), "result lacks seed"),
        (changed(sead=1), "result has the unknown key sead"),
        (changed(seed=1.5), "result.seed: expected int, found float '1.5'"),
        (changed(seed=True), "result.seed: expected int, found bool"),
        (changed(metrics={"psnr": "high"}), "result.metrics.psnr: expected int | float"),
        (changed(metrics=[1]), "result.metrics: expected dict"),
        (changed(images=[{"name": "a"}]), r"result.images\[0\] lacks metrics, truth_sha256"),
        (changed(left_out=[["b"]]), r"result.left_out\[0\]: expected 2 items, found 1"),
    ],
)
def test_bad_records_are_named(text: str, message: str):
    with pytest.raises(DataError, match=message) as caught:
        result_from_json(text, "case/record.json")
    assert str(caught.value).startswith("case/record.json: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("value", ["NaN", object(), {1: 2}, b"raw"])
def test_values_that_would_not_come_back_are_refused(value: object):
    with pytest.raises(TypeError, match=r"settings\.x"):
        result_to_json(dataclasses.replace(a_result(), settings={"x": value}))
