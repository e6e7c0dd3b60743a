"""What is said of a name that does not exist."""

import pytest

from splatproof.base.names import LISTED, did_you_mean, unknown


@pytest.mark.parametrize(
    ("name", "known", "said"),
    [
        ("psrn", ["psnr", "flip"], "metric: unknown 'psrn', did you mean 'psnr'? There are: flip, psnr"),
        ("xyz", ["psnr", "flip"], "metric: unknown 'xyz'. There are: flip, psnr"),
        ("xyz", [], "metric: unknown 'xyz'. There are: none"),
        ("", ["psnr"], "metric: unknown ''. There are: psnr"),
    ],
)  # fmt: skip
def test_wording(name, known, said):
    assert str(unknown("metric", name, known)) == said
    assert unknown("metric", name, known).exit_code == 2


def test_a_long_list_is_counted_and_still_gives_the_nearest():
    many = [f"photo_{i:03}.png" for i in range(LISTED + 1)]
    assert did_you_mean("photo_7.png", many).endswith(f"? There are: {LISTED + 1}")
    assert "did you mean 'photo_012.png'?" in did_you_mean("foto_012.png", many)
    assert did_you_mean("x", many[1:]).endswith(many[-1])
