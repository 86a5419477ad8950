"""A bad link is as bad as asked for, and the same for the same seed."""

import numpy as np
import pytest

from wisar_planner.errors import InvalidInput
from wisar_sim.autopilot.bad_link import BadLink, LinkFaults

COUNT = 5_000


def carry(**faults):
    link = BadLink(LinkFaults(**faults), seed=1)
    out = []
    for n in range(COUNT):
        link.put(n.to_bytes(4, "little") + bytes(20), 0.01 * n)
        out += [(0.01 * n, d) for d in link.take(0.01 * n)]
    while link.next_arrival < float("inf"):
        now = link.next_arrival
        out += [(now, d) for d in link.take(now)]
    return out


def numbers(out):
    return [int.from_bytes(d[:4], "little") for _, d in out]


def test_a_good_link_carries_everything_in_order():
    assert numbers(carry()) == list(range(COUNT))


@pytest.mark.parametrize("loss", [0.1, 0.5, 1.0])
def test_loss(loss):
    assert len(carry(loss=loss)) == pytest.approx(COUNT * (1.0 - loss), abs=150)


def test_duplication():
    out = numbers(carry(duplication=0.2, jitter_s=0.05))
    assert len(out) == pytest.approx(1.2 * COUNT, abs=150)
    assert set(out) == set(range(COUNT))


def test_reordering():
    out = numbers(carry(reordering=0.2))
    assert sorted(out) == list(range(COUNT))
    assert sum(np.diff(out) < 0) > 100


def test_corruption_changes_some_frames():
    out = carry(corruption=0.3)
    damaged = sum(data[4:] != bytes(20) or len(data) != 24 for _, data in out)
    assert 0.15 * COUNT < damaged < 0.3 * COUNT + 150


def test_delay():
    link = BadLink(LinkFaults(delay_s=0.5, jitter_s=0.2))
    link.put(b"x", 10.0)
    assert 10.5 <= link.next_arrival <= 10.7
    assert link.take(10.49) == []
    assert link.take(10.7) == [b"x"]


def test_the_same_seed_gives_the_same_faults():
    faults = {"loss": 0.3, "duplication": 0.2, "reordering": 0.2, "corruption": 0.2}
    assert carry(**faults) == carry(**faults)


@pytest.mark.parametrize("wrong", [{"loss": 1.5}, {"delay_s": -1.0}, {"corruption": float("nan")}])
def test_impossible_faults_are_refused(wrong):
    with pytest.raises(InvalidInput, match=next(iter(wrong))):
        LinkFaults(**wrong)
