"""Protocol files: all of ours load, and every mistake is named in one line."""

import dataclasses

import pytest

from splatproof.base.errors import UsageError
from splatproof.metrics.protocol_files import KEYS, load_protocol, protocol_names
from splatproof.reference.types.protocol import Protocol


@pytest.mark.parametrize("name", protocol_names())
def test_each_of_ours_loads_and_says_its_source(name):
    protocol = load_protocol(name)
    assert protocol.name == name
    assert protocol.source
    assert not protocol.colour_fit  # never in a column that is ranked unless asked for
    # its rows are not ranked, and its name says why
    assert (protocol.appearance == "oracle") == name.endswith("_oracle")


def test_the_default_is_the_default_of_the_type():
    assert load_protocol("default") == Protocol(name="default", source="ours")


def test_what_ours_change():
    rules = {name: dataclasses.asdict(load_protocol(name)) for name in protocol_names()}
    changed = {
        name: {
            key: value
            for key, value in rules[name].items()
            if key not in ("name", "source") and value != rules["default"][key]
        }
        for name in rules
    }
    # those of the public data sets are tried on fixtures of their sets (tests/datasets/adapters)
    expected = {
        "default": {},
        "quick": {"width": 240},
        "width_500": {"width": 500},
        "brighton_250": {"width": 250, "test_names": ("dji_0026.jpg",)},
        "brighton_500": {"width": 500, "test_names": ("dji_0026.jpg",)},
        "brighton_quarter": {"width": 250, "hold": 4},
        "city_400": {"width": 400},
        "city_unseen": {"width": 320, "test_folder": "unseen"},
        "unseen": {"test_folder": "unseen"},
        "float": {"rounding": "float"},
        "truncate": {"rounding": "truncate"},
        "3dgs": {
            "images": "images",
            "max_width": 1600,
            "size_rule": "floor",
            "filter": "bicubic",
            "masked": False,
            "metrics": ("psnr", "ssim_3dgs"),
        },
        "blender": {
            "images": "images",
            "background": (1.0, 1.0, 1.0),
            "masked": False,
            "metrics": ("psnr", "ssim_3dgs"),
        },
        "mega-nerf": {
            "images": "images",
            "factor": 4.0,
            "filter": "lanczos",
            "rounding": "float",
            "masked": False,
            "region": "right_half",
            "appearance": "half",
            "metrics": ("psnr", "ssim_3dgs"),
        },
    }
    assert {name: changed[name] for name in expected} == expected


def test_a_file_of_ones_own(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(
        'source = "me"\nwidth = 640\nbackground = [1, 1.0, 0.5]\ntest_names = ["b.jpg", "a.jpg"]\n'
        'colour_fit = ["cc_affine"]\nmetrics = ["flip"]\nhold = 0\ndrop_test_points = true\n'
    )
    want = Protocol(
        name="mine",
        source="me",
        width=640,
        background=(1.0, 1.0, 0.5),
        test_names=("b.jpg", "a.jpg"),
        colour_fit=("cc_affine",),
        metrics=("flip",),
        hold=0,
        drop_test_points=True,
    )
    assert load_protocol(path) == load_protocol(str(path)) == want
    assert isinstance(load_protocol(path).background[0], float)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("widht = 3", "unknown 'widht', did you mean 'width'"),
        ('name = "other"', "unknown 'name'"),
        ('width = "250"', "width: .*integer.*found '250'"),
        ("width = 2.5", "width: .*integer.*found 2.5"),
        ("width = 0", "width is 0"),
        ("width = 250\nfactor = 2", "both width and factor"),
        ("width = 250\nmax_width = 200", "both width and max_width"),
        ("factor = 2\nmax_width = 200", "both factor and max_width"),
        ("max_width = 0", "max_width is 0"),
        ("factor = 0", "factor is 0"),
        ("factor = 0.5", "factor is 0.5"),
        ("factor = nan", "factor is nan"),
        ("factor = inf", "factor is inf"),
        ("hold = -1", "hold is -1"),
        ("hold_first = -2", "hold_first is -2"),
        ('clips = [["a", 5, 3]]', "clips: 'a' goes from 5 to 3, not forward from 0"),
        ('clips = [["a", -1, 3]]', "clips: 'a' goes from -1 to 3"),
        ('clips = [["a", 1]]', r"clips\[0\]\[2\] is missing"),
        ('clips = [["a", 1, 2], ["a", 3, 4]]', "clips names one twice: a, a"),
        ("train_views = -3", "train_views is -3, expected 0 or more"),
        ('scored = "all"', "scored: .*'held-out' or 'training', found 'all'"),
        ('points = "none"', "points: .*'scene' or 'triangulated', found 'none'"),
        ('hold_unit = "day"', "hold_unit: .*'view' or 'time', found 'day'"),
        ('sensors = ["a", "a"]', "sensors names one twice: a, a"),
        ("hold = true", "hold: .*integer.*found True"),
        ("masked = 1", "masked: .*boolean.*found 1"),
        (
            'filter = "nearest"',
            "filter: .*'area', 'lanczos', 'bicubic' or 'bilinear', found 'nearest'",
        ),
        ('rounding = "up"', "rounding: .*'round', 'truncate' or 'float', found 'up'"),
        ('region = "left_half"', "region: .*found 'left_half'"),
        ("background = [0, 0]", r"background\[2\] is missing"),
        ("background = [0, 0, 2]", "background is .* expected three numbers in"),
        ("metrics = []", "metrics is empty"),
        ('metrics = "psnr"', "metrics: .*tuple|metrics: .*array"),
        ('metrics = ["psnr", "psrn"]', "metrics: metric: unknown 'psrn', did you mean 'psnr'"),
        ('metrics = ["psnr", "psnr"]', "metrics names one twice"),
        ('colour_fit = ["cc"]', r"colour_fit\[0\]: .*'cc_affine' or 'cc_quadratic', found 'cc'"),
        ('images = ""', "images is empty"),
        ("hold = 1979-05-27", "hold: .*integer"),
        ("hold = ", "not a TOML file"),
        ("[rules]", "unknown 'rules'"),
    ],
)
def test_every_mistake_is_named_with_its_file(tmp_path, line, message):
    path = tmp_path / "mine.toml"
    path.write_text(f'source = "me"\n{line}\n')
    with pytest.raises(UsageError, match=message) as caught:
        load_protocol(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", 'source = "  "\n', "source = 3\n"])
def test_a_protocol_without_a_source_is_refused(tmp_path, text):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(UsageError, match="source"):
        load_protocol(path)


@pytest.mark.parametrize("name", ["defalt", "", "../default", "../protocols/default"])
def test_an_unknown_name_is_refused_with_the_nearest(name):
    with pytest.raises(UsageError, match="a .toml file.: unknown .*There are: 3das_7, 3dgs"):
        load_protocol(name)


def test_a_missing_folder_or_binary_file_is_refused(tmp_path):
    with pytest.raises(UsageError, match="no.toml: no such file"):
        load_protocol(tmp_path / "no.toml")
    folder = tmp_path / "folder.toml"
    folder.mkdir()
    with pytest.raises(UsageError, match="is a folder, expected a file"):
        load_protocol(folder)
    path = tmp_path / "binary.toml"
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(UsageError, match="not UTF-8 text"):
        load_protocol(path)


def test_every_rule_can_be_given():
    assert set(KEYS) == {f.name for f in dataclasses.fields(Protocol)} - {"name"}
