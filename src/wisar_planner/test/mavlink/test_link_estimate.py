"""What the state machines learn about a link."""

import numpy as np
import pytest

from wisar_planner.mavlink.link_estimate import LinkEstimate, RetryPolicy


def test_the_first_timeout_is_the_policys():
    assert LinkEstimate(RetryPolicy(initial_timeout=0.7)).timeout == 0.7


@pytest.mark.parametrize("round_trip", [0.06, 0.4, 1.2])
def test_the_timeout_follows_the_round_trip(round_trip):
    link = LinkEstimate(RetryPolicy())
    for _ in range(10):
        link.answered(1, round_trip)
    assert link.round_trip == pytest.approx(round_trip)
    assert 1.5 * round_trip < link.timeout < 4.0 * round_trip


def test_bounds_hold():
    fast, slow = LinkEstimate(RetryPolicy()), LinkEstimate(RetryPolicy())
    for _ in range(10):
        fast.answered(1, 1e-4)
        slow.answered(1, 30.0)
    assert fast.timeout == RetryPolicy().min_timeout
    assert slow.timeout == RetryPolicy().max_timeout


def test_late_answers_do_not_feed_on_themselves():
    """Half of the answers come only after the autopilot asked again by itself."""
    rng = np.random.default_rng(0)
    link = LinkEstimate(RetryPolicy())
    for _ in range(500):
        late = rng.random() < 0.5
        link.answered(1, 0.06 + late * rng.uniform(0.0, max(link.timeout, 0.26)))
    assert link.timeout < 0.35


def test_a_link_slower_than_the_first_guess_is_learnt_although_no_answer_is_unambiguous():
    link = LinkEstimate(RetryPolicy())
    for _ in range(6):
        tries = int(1.5 // link.timeout) + 1
        link.answered(tries, 1.5)
    assert 1.5 < link.timeout < 4.0


def test_losses_are_not_taken_for_a_slow_link():
    rng = np.random.default_rng(1)
    link = LinkEstimate(RetryPolicy())
    longest = 0.0
    for _ in range(300):
        tries = int(rng.geometric(0.25))
        link.answered(tries, 0.06 + (tries - 1) * link.timeout)
        longest = max(longest, link.timeout)
    assert link.timeout < 0.3
    assert longest <= 1.0


def test_waiting_gets_longer_only_when_losses_do_not_explain_the_silence():
    link = LinkEstimate(RetryPolicy())
    for _ in range(200):
        link.answered(1, 0.2)
    before = link.timeout
    for _ in range(40):
        link.timed_out()
    assert link.timeout > 2.0 * before
    link.answered(41, 5.0)
    assert link.timeout == pytest.approx(before)


def test_the_worse_the_link_the_longer_silence_is_innocent():
    good, bad = LinkEstimate(RetryPolicy()), LinkEstimate(RetryPolicy())
    for _ in range(400):
        good.answered(1, 0.1)
        bad.answered(4, 0.4)
    assert good.suspicious_tries() < bad.suspicious_tries()
    # Right for the bad link: so many tries in a row fail about once in a thousand questions.
    assert 0.75 ** bad.suspicious_tries() < 1e-2


def test_giving_up_takes_tries_and_time():
    policy = RetryPolicy(max_tries=30, patience_s=20.0)
    assert not policy.exhausted(9, 100.0)
    assert not policy.exhausted(29, 1.0)
    assert policy.exhausted(30, 1.0)
    assert policy.exhausted(10, 20.0)
