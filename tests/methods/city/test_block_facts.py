"""What blocks say for the record of their run."""

from dataclasses import replace

from splatproof.methods.city.block_facts import BlockFacts, least_visited, told_by


def block(number: int, **told: str) -> BlockFacts:
    return BlockFacts(block=number, views=1, points=2, load=3, told=told)


def test_what_blocks_say_alike_is_said_once_and_what_they_do_not_with_its_blocks():
    blocks = [
        block(0, refiner="in domain", share="0.200", views="4 views"),
        block(1),
        block(2, refiner="in domain", share="0.1", views="8 views"),
        block(3, refiner="in domain", share="0.150", views="4 views"),
    ]
    assert told_by(blocks) == {
        "refiner": "in domain",
        "share": "0.1 to 0.200",
        "views": "4 views (blocks 0, 3); 8 views (block 2)",
    }
    assert told_by([block(0)]) == {}


def test_the_photo_that_was_visited_least_counts_and_empty_blocks_do_not():
    trained = replace(block(0), primitives=5, least_visits=41)
    empty = replace(block(2), least_visits=0)
    assert least_visited([trained, replace(trained, least_visits=39), empty]) == 39
    assert least_visited([trained, replace(trained, least_visits=-1)]) is None
    assert least_visited([empty]) is None
