import numpy as np
import pytest

from wisar_planner.errors import InvalidInput
from wisar_planner.evaluation.streams import Facet, stream


def draw(*key, seed=0):
    return tuple(stream(seed, *key).integers(2**63, size=4))


def test_every_index_facet_and_seed_has_numbers_of_its_own():
    drawn = {
        draw(index, facet, seed=seed)
        for seed in (0, 1, 2)
        for index in range(50)
        for facet in Facet
    }
    assert len(drawn) == 3 * 50 * len(Facet)


def test_a_stream_depends_on_its_key_alone():
    before = draw(7, Facet.MAP)
    np.random.default_rng(0).random(100)
    assert draw(7, Facet.MAP) == before


def test_published_numbers_stay_what_they_are():
    # Every result in the tables hangs on these; a change here makes all of them irreproducible.
    assert stream(0, 0, Facet.MAP).random() == 0.6027619159910471


@pytest.mark.parametrize(("seed", "index", "named"), [(-1, 0, "seed"), (0, -1, "index")])
def test_negative_numbers_are_refused(seed, index, named):
    with pytest.raises(InvalidInput, match=named):
        stream(seed, index, Facet.MAP)
