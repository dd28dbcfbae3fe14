# SPDX-License-Identifier: Apache-2.0
import numpy as np

from multilica.results import PreprocessedCloud
from multilica.stages.pair_choice import choose_target
from tests.unit.made_pairs import UNCERTAIN, pair, pose, undecided

_CLOUDS = {
    name: PreprocessedCloud(name, np.zeros((count, 3)), np.zeros((count, 3)))
    for name, count in {"a": 5, "b": 9, "c": 7}.items()
}


def test_the_target_of_the_user_is_taken():
    assert choose_target("c", _CLOUDS, [pair(pose("a", "b"))]) == ("c", "set by --target")


def test_the_lidar_with_the_most_overlap_is_the_target():
    pairs = [
        pair(pose("a", "b"), fitness=0.4),
        pair(pose("c", "a"), fitness=0.5),
        pair(pose("b", "c"), undecided("ambiguous"), fitness=0.9),
    ]
    assert choose_target("", _CLOUDS, pairs) == ("a", "most overlap, the fitness of its pairs adds up to 0.90")


def test_with_equal_overlap_the_most_points_decide():
    assert choose_target("", _CLOUDS, [pair(pose("a", "b"))])[0] == "b"


def test_without_an_accepted_pair_the_most_points_decide():
    pairs = [pair(pose("a", "c"), undecided("ambiguous"))]
    assert choose_target("", _CLOUDS, pairs) == ("b", "most points, as no pair was accepted")


def test_accepted_pairs_without_fitness_count_as_accepted():
    _, reason = choose_target("", _CLOUDS, [pair(pose("a", "c"), fitness=0.0)])
    assert reason == "most overlap, the fitness of its pairs adds up to 0.00"


def test_uncertain_pairs_choose_it_where_none_is_accepted():
    pairs = [pair(pose("a", "c"), UNCERTAIN, fitness=0.2), pair(pose("a", "b"), undecided("ambiguous"))]
    assert choose_target("", _CLOUDS, pairs)[0] == "c"
    assert choose_target("", _CLOUDS, [*pairs, pair(pose("a", "b"), fitness=0.1)])[0] == "b"
